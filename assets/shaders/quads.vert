// 128 quads an instance, far to near.
uniform usampler2D u_ellipses;
uniform usampler2D u_looks;
uniform int u_count;
uniform int u_first;             // instance that this call begins with
uniform vec2 u_size;

in vec3 in_corner;              // x, y in -1..1; number of the quad in the instance

out vec2 v_corner;
flat out vec4 v_color;          // rgb (or depth in r), opacity
flat out float v_cut;           // ln(255 opacity): exponent at the quad's rim
#ifdef MASK
flat out vec2 v_mask;
#endif

void main()
{
    gl_Position = vec4(0.0, 0.0, 2.0, 1.0);  // outside: nothing is drawn
    int rank = (u_first + gl_InstanceID) * 128 + int(in_corner.z);
    if (rank >= u_count) return;
    ivec2 at = texel_of(rank);
    uvec4 ellipse = texelFetch(u_ellipses, at, 0);
    if (ellipse.w == 0u) return;
    uvec2 look = texelFetch(u_looks, at, 0).rg;
    float opacity = unpack_unit(ellipse.w).y;
#ifdef DEPTH
    v_color = vec4(uintBitsToFloat(look.x), 0.0, 0.0, opacity);
#else
    v_color = vec4(vec3(unpack_unit(look.x), unpack_unit(look.y).x) * COLOR_RANGE, opacity);
#endif
    v_cut = log(255.0 * opacity);
#ifdef MASK
    v_mask = vec2((look.y >> 16) & 1u, look.y >> 17);
#endif
    v_corner = in_corner.xy;
    vec2 long_axis = unpack_lengths(ellipse.z);
    vec2 short_axis = of_half(ellipse.w & 0xffffu) * normalize(vec2(-long_axis.y, long_axis.x));
    vec2 pixel = uintBitsToFloat(ellipse.xy) + in_corner.x * long_axis + in_corner.y * short_axis;
    gl_Position = vec4(2.0 * pixel.x / u_size.x - 1.0, 1.0 - 2.0 * pixel.y / u_size.y, 0.0, 1.0);
}
