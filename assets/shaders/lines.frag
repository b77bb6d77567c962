flat in vec4 v_color;
flat in float v_half;
in float v_across;
layout(location = 0) out vec4 o_color;

void main()
{
    float cover = clamp(v_half - 0.5 - abs(v_across), 0.0, 1.0);
    o_color = vec4(v_color.rgb, 1.0) * (v_color.a * cover);
}
