// The marked tiles of the picture, an instance each.
uniform sampler2D u_marks;      // 1 where an outline can reach into the tile
uniform vec2 u_picture;         // size in pixels

void main()
{
    ivec2 size = textureSize(u_marks, 0);
    ivec2 tile = ivec2(gl_InstanceID % size.x, gl_InstanceID / size.x);
    vec2 corner = vec2(tile + ivec2(gl_VertexID & 1, gl_VertexID >> 1)) * float(TILE);
    bool is_marked = texelFetch(u_marks, tile, 0).r > 0.5;
    // Outside: nothing is drawn.
    gl_Position = vec4(is_marked ? 2.0 * corner / u_picture - 1.0 : vec2(2.0), 0.0, 1.0);
}
