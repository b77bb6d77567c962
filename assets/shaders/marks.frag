// One pixel a tile of the picture: whether an outline can reach into it.
uniform sampler2D u_mask;       // shares: r selected, g hovered
uniform vec2 u_picture;         // size in pixels
uniform float u_reach;          // of outlines, pixels

layout(location = 0) out float o_is_marked;

void main()
{
    vec2 first = floor(gl_FragCoord.xy) * float(TILE);
    ivec2 size = textureSize(u_mask, 0);
    vec2 texels = vec2(size) / u_picture;  // a pixel
    // One texel more to each side: the mask is read in between its texels.
    ivec2 low = max(ivec2(floor((first - u_reach) * texels)) - 1, 0);
    ivec2 high = min(ivec2(ceil((first + float(TILE) + u_reach) * texels)) + 1, size);
    vec2 most = vec2(0.0);
    for (int y = low.y; y < high.y; ++y)
        for (int x = low.x; x < high.x; ++x)
            most = max(most, texelFetch(u_mask, ivec2(x, y), 0).rg);
    o_is_marked = max(most.r, most.g) > LEAST_SHARE ? 1.0 : 0.0;
}
