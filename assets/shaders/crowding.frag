// One pixel an area of the picture: how many outlines as long as its side are in it.
uniform sampler2D u_mask;       // shares: r selected, g hovered
uniform vec2 u_picture;         // size in pixels
uniform float u_area;           // side of an area, pixels

layout(location = 0) out vec2 o_lines;

void main()
{
    ivec2 size = textureSize(u_mask, 0);
    vec2 texels = vec2(size) / u_picture;  // a pixel
    vec2 first = floor(gl_FragCoord.xy) * u_area;
    ivec2 low = ivec2(first * texels), high = min(ivec2((first + u_area) * texels), size - 1);
    vec2 length_in_texels = vec2(0.0);
    for (int y = low.y; y < high.y; ++y)
        for (int x = low.x; x < high.x; ++x) {
            vec2 here = step(0.5, texelFetch(u_mask, ivec2(x, y), 0).rg);
            vec2 right = step(0.5, texelFetch(u_mask, ivec2(x + 1, y), 0).rg);
            vec2 above = step(0.5, texelFetch(u_mask, ivec2(x, y + 1), 0).rg);
            length_in_texels += abs(here - right) + abs(here - above);
        }
    o_lines = length_in_texels / texels / u_area;
}
