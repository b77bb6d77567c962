// A line as a quad: OpenGL 3.3 core draws no wide lines on every driver.
uniform mat4 u_cam_from_world;
uniform vec4 u_lens;            // fx, fy, cx, cy in pixels
uniform vec2 u_size;
uniform float u_width_scale;

in vec2 in_corner;              // along 0..1, across -1..1
in vec3 in_from;                // world
in vec3 in_to;
in vec4 in_color;
in float in_width;              // pixels

flat out vec4 v_color;
flat out float v_half;          // half width in pixels, with a pixel for the soft rim
out float v_across;

vec2 pixel_of(vec3 p_cam) { return u_lens.xy * p_cam.xy / p_cam.z + u_lens.zw; }

void main()
{
    gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
    vec3 a = (u_cam_from_world * vec4(in_from, 1.0)).xyz;
    vec3 b = (u_cam_from_world * vec4(in_to, 1.0)).xyz;
    if (a.z < NEAR && b.z < NEAR) return;
    if (a.z < NEAR) a = mix(a, b, (NEAR - a.z) / (b.z - a.z));
    if (b.z < NEAR) b = mix(b, a, (NEAR - b.z) / (a.z - b.z));
    vec2 from = pixel_of(a), to = pixel_of(b);
    vec2 along = to - from;
    float len = length(along);
    along = len > 1e-6 ? along / len : vec2(1.0, 0.0);
    v_color = in_color;
    v_half = 0.5 * in_width * u_width_scale + 1.0;
    v_across = in_corner.y * v_half;
    vec2 pixel = mix(from, to, in_corner.x) + vec2(-along.y, along.x) * v_across;
    gl_Position = vec4(2.0 * pixel.x / u_size.x - 1.0, 1.0 - 2.0 * pixel.y / u_size.y, 0.0, 1.0);
}
