// Premultiplied "over". With MASK the same blending gives the share of marked splats.
in vec2 v_corner;
flat in vec4 v_color;
flat in float v_cut;
#ifdef MASK
flat in vec2 v_mask;
layout(location = 1) out vec4 o_mask;
#endif
#ifdef DEPTH
uniform float u_far;            // scale: half floats hold depths as a share of it
#endif
layout(location = 0) out vec4 o_color;

void main()
{
    float r = dot(v_corner, v_corner);
    if (r > 1.0) discard;
#ifdef CENTRES
    float alpha = 1.0 - smoothstep(0.55, 1.0, r);
#else
    float alpha = min(0.99, v_color.a * exp(-v_cut * r));
#endif
#ifdef RINGS
    alpha = r > 0.84 ? 0.65 : 0.12 * alpha;
#endif
    if (alpha < 1.0 / 255.0) discard;
#ifdef DEPTH
    o_color = vec4(v_color.r / u_far * alpha, 0.0, 0.0, alpha);
#else
    o_color = vec4(v_color.rgb * alpha, alpha);
#endif
#ifdef MASK
    o_mask = vec4(v_mask * alpha, 0.0, alpha);
#endif
}
