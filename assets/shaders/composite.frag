// The finished picture: blended splats over the background, depth as color, outlines.
uniform sampler2D u_splats;
#ifdef MASK
uniform sampler2D u_mask;       // shares: r selected, g hovered
uniform vec2 u_outline;         // half widths in pixels: selected, hovered
uniform vec3 u_accent;
uniform vec3 u_hover;
#ifdef MOST_LINES
uniform sampler2D u_crowding;   // outlines of the length of an area's side, in each: rg as u_mask
uniform float u_area;           // side of an area, pixels
#endif
#endif
uniform vec2 u_picture;         // size in pixels
uniform vec3 u_background;
#ifdef DEPTH
uniform vec2 u_near_far;        // log of the depths that get the ends of the color map
uniform float u_far;
#endif

layout(location = 0) out vec4 o_color;

#ifdef DEPTH
uniform vec3 u_depth_polynomial[6];  // gaga_core/color.py: coefficients of t^5 ... 1

vec3 depth_color(float t)
{
    vec3 color = u_depth_polynomial[0];
    for (int i = 1; i < 6; i++)
        color = color * t + u_depth_polynomial[i];
    return clamp(color, 0.0, 1.0);
}
#endif

#ifdef MASK
// Where the share crosses one half, from the outside: strength of a line of this half width for
// r selected and g hovered, and in ba of a soft dark rim twice as wide, which keeps the line
// readable on a ground of its own color.
// As far as 2 * u_outline away: marks.frag looks for marks as far, and beyond LEAST_SHARE.
vec4 edges(vec2 at)
{
    vec2 here = smoothstep(LEAST_SHARE, 0.65, texture(u_mask, at).rg);
    vec4 most = vec4(0.0);
    for (int ring = 1; ring <= 4; ++ring) {
        for (int k = 0; k < 12; ++k) {
            float angle = (float(k) + 0.5 * float(ring)) * 0.5235987756;
            vec2 way = vec2(cos(angle), sin(angle)) * (0.5 * float(ring)) / u_picture;
            vec2 share = smoothstep(LEAST_SHARE, 0.65, vec2(
                texture(u_mask, at + way * u_outline.x).r,
                texture(u_mask, at + way * u_outline.y).g));
            if (ring <= 2) most.rg = max(most.rg, share);
            most.ba = max(most.ba, share * (1.0 - 0.25 * float(ring - 1)));
        }
    }
    return most * vec4(1.0 - here, 1.0 - here);
}
#endif

void main()
{
    vec2 at = gl_FragCoord.xy / u_picture;
    vec4 splats = texture(u_splats, at);
    vec3 color = splats.rgb;
#ifdef DEPTH
    float depth = splats.r / max(splats.a, 1e-6) * u_far;
    float t = (log(max(depth, 1e-20)) - u_near_far.x) / max(u_near_far.y - u_near_far.x, 1e-6);
    color = depth_color(clamp(t, 0.0, 1.0)) * splats.a;
#endif
    color = clamp(color + (1.0 - splats.a) * u_background, 0.0, 1.0);
#ifdef MASK
    vec4 line = edges(at);
#ifdef MOST_LINES
    // Where lines are crowded they share what so many take that are apart: the picture stays seen.
    vec2 crowding = texture(
        u_crowding, gl_FragCoord.xy / (u_area * vec2(textureSize(u_crowding, 0)))).rg;
    line *= (MOST_LINES / max(crowding, MOST_LINES)).rgrg;
#endif
    color *= 1.0 - 0.45 * max(line.b, 0.6 * line.a);
    color = mix(color, u_hover, 0.8 * line.g);
    color = mix(color, u_accent, line.r);
#endif
    o_color = vec4(color, 1.0);
}
