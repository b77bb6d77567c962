// Projection, once per splat: fragment k of a 2048 wide target is the k-th splat of the depth order.
// The image model is the one of gaga_core/raster/base.py (3D Gaussian Splatting, Kerbl 2023).
uniform usampler2D u_order;        // splat of each rank
uniform sampler2D u_means;         // xyz
uniform usampler2D u_shape;        // 8 x 16 bit: quaternion wxyz, log scales, opacity
uniform sampler2DArray u_sh;       // N_SH x 3 halfs, four a layer
uniform usampler2D u_state;
uniform isampler2D u_labels;
uniform isampler2D u_placement;
uniform sampler2D u_placements;    // 16 texels a row, 128 rows a line
uniform sampler2D u_palette;       // color of each label

uniform int u_count;               // splats in the order
uniform mat4 u_cam_from_world;
uniform vec3 u_eye;                // world
uniform vec4 u_lens;               // fx, fy, cx, cy in pixels of the target
uniform vec2 u_size;               // target in pixels
uniform vec2 u_log_scale;          // fixed point of log scales: low end, range
uniform int u_mode;                // 0 color, 1 groups, 2 depth
uniform int u_hovered;             // label, 0 = none

layout(location = 0) out vec4 o_ellipse;   // centre in pixels, long half-axis of the quad
layout(location = 1) out uvec4 o_look;     // short half-axis, (r, g) or depth, (b, opacity), flags

const float NEAR = 0.01;
const float BLUR = 0.3;
const float ALPHA_MIN = 1.0 / 255.0;

vec4 placement_texel(int row, int column)
{
    return texelFetch(u_placements, ivec2(((row & 127) << 4) + column, row >> 7), 0);
}

mat3 rotation_of(vec4 q)  // wxyz, of unit length
{
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec3 sh_color(int id, vec3 d)
{
    float basis[N_SH];
    basis[0] = 0.28209479177387814;
#if N_SH > 1
    float x = d.x, y = d.y, z = d.z;
    basis[1] = -0.4886025119029199 * y;
    basis[2] = 0.4886025119029199 * z;
    basis[3] = -0.4886025119029199 * x;
#endif
#if N_SH > 4
    float xx = x * x, yy = y * y, zz = z * z;
    basis[4] = 1.0925484305920792 * x * y;
    basis[5] = -1.0925484305920792 * y * z;
    basis[6] = 0.31539156525252005 * (2.0 * zz - xx - yy);
    basis[7] = -1.0925484305920792 * x * z;
    basis[8] = 0.5462742152960396 * (xx - yy);
#endif
#if N_SH > 9
    basis[9] = -0.5900435899266435 * y * (3.0 * xx - yy);
    basis[10] = 2.890611442640554 * x * y * z;
    basis[11] = -0.4570457994644658 * y * (4.0 * zz - xx - yy);
    basis[12] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    basis[13] = -0.4570457994644658 * x * (4.0 * zz - xx - yy);
    basis[14] = 1.445305721320277 * z * (xx - yy);
    basis[15] = -0.5900435899266435 * x * (xx - 3.0 * yy);
#endif
#if N_SH > 16
    basis[16] = 2.5033429417967046 * x * y * (xx - yy);
    basis[17] = -1.7701307697799304 * y * z * (3.0 * xx - yy);
    basis[18] = 0.9461746957575601 * x * y * (7.0 * zz - 1.0);
    basis[19] = -0.6690465435572892 * y * z * (7.0 * zz - 3.0);
    basis[20] = 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0);
    basis[21] = -0.6690465435572892 * x * z * (7.0 * zz - 3.0);
    basis[22] = 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0);
    basis[23] = -1.7701307697799304 * x * z * (xx - 3.0 * yy);
    basis[24] = 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
#endif
    float sums[N_LAYERS * 4 + 3];
    for (int layer = 0; layer < N_LAYERS; ++layer) {
        vec4 four = texelFetch(u_sh, ivec3(texel_of(id), layer), 0);
        sums[layer * 4] = four.x;
        sums[layer * 4 + 1] = four.y;
        sums[layer * 4 + 2] = four.z;
        sums[layer * 4 + 3] = four.w;
    }
    vec3 color = vec3(0.5);
    for (int k = 0; k < N_SH; ++k)
        color += basis[k] * vec3(sums[3 * k], sums[3 * k + 1], sums[3 * k + 2]);
    return color;
}

void main()
{
    o_ellipse = vec4(0.0);
    o_look = uvec4(0u);
    int rank = int(gl_FragCoord.y) * 2048 + int(gl_FragCoord.x);
    if (rank >= u_count) return;
    int id = int(texelFetch(u_order, texel_of(rank), 0).r);
    ivec2 at = texel_of(id);
    uint state = texelFetch(u_state, at, 0).r;
    if ((state & (HIDDEN | DELETED)) != 0u) return;

    int row = texelFetch(u_placement, at, 0).r;
    vec4 m0 = placement_texel(row, 0), m1 = placement_texel(row, 1), m2 = placement_texel(row, 2);
    uvec4 words = texelFetch(u_shape, at, 0);
    vec2 tail = unpack_unit(words.w);
    float opacity = min(1.0, tail.y * placement_texel(row, 9).x);
    if (opacity < ALPHA_MIN) return;

    vec4 mean = vec4(texelFetch(u_means, at, 0).xyz, 1.0);
    vec3 p_world = vec3(dot(m0, mean), dot(m1, mean), dot(m2, mean));
    vec3 p_cam = (u_cam_from_world * vec4(p_world, 1.0)).xyz;
    if (!(p_cam.z >= NEAR && p_cam.z < 1e30)) return;

    // Covariance of the ellipse = T T^t + BLUR, with T = J W A R S (2 x 3).
    vec4 quat = normalize(vec4(unpack_unit(words.x), unpack_unit(words.y)) * 2.0 - 1.0);
    vec3 log_scales = u_log_scale.x + u_log_scale.y * vec3(unpack_unit(words.z), tail.x);
    mat3 axes = rotation_of(quat);
    vec3 scales = exp(log_scales);
    mat3 placed = transpose(mat3(m0.xyz, m1.xyz, m2.xyz));
    mat3 M = mat3(u_cam_from_world) * placed
        * mat3(axes[0] * scales.x, axes[1] * scales.y, axes[2] * scales.z);
    vec2 focal = u_lens.xy;
    float iz = 1.0 / p_cam.z;
    vec2 limit = 1.3 * 0.5 * u_size / focal;
    vec2 slope = clamp(p_cam.xy * iz, -limit, limit);
    vec3 jx = vec3(focal.x * iz, 0.0, -focal.x * slope.x * iz);
    vec3 jy = vec3(0.0, focal.y * iz, -focal.y * slope.y * iz);
    vec3 tx = jx * M, ty = jy * M;
    float a = dot(tx, tx) + BLUR, b = dot(tx, ty), d = dot(ty, ty) + BLUR;
    // |tx x ty|^2 is the determinant without the cancellation of a d - b b (needles).
    vec3 normal = cross(tx, ty);
    float det = dot(normal, normal) + BLUR * (dot(tx, tx) + dot(ty, ty)) + BLUR * BLUR;
    float mid = 0.5 * (a + d);
    float long_variance = mid + length(vec2(0.5 * (a - d), b));
    float short_variance = det / long_variance;
    if (!(long_variance < 1e30 && short_variance > 0.0)) return;
    vec2 axis = a >= d ? vec2(long_variance - d, b) : vec2(b, long_variance - a);
    float axis_length = length(axis);
    axis = axis_length > 1e-12 ? axis / axis_length : vec2(1.0, 0.0);

    // The quad ends where alpha falls under 1/255.
    float reach = sqrt(2.0 * max(0.0, log(opacity * 255.0)));
    vec2 centre = focal * p_cam.xy * iz + u_lens.zw;
    vec2 box = reach * sqrt(vec2(a, d));
    if (any(lessThan(centre + box, vec2(0.0))) || any(greaterThan(centre - box, u_size))) return;

    int label = max(0, texelFetch(u_labels, at, 0).r);
    uint flags = ((state & SELECTED) != 0u ? 1u : 0u) | (label > 0 && label == u_hovered ? 2u : 0u);
    o_ellipse = vec4(centre, axis * (reach * sqrt(long_variance)));
    o_look = uvec4(floatBitsToUint(reach * sqrt(short_variance)), 0u, 0u, flags);
    if (u_mode == 2) {
        o_look.yz = uvec2(floatBitsToUint(p_cam.z), pack_unit(vec2(0.0, opacity)));
        return;
    }

    vec3 away = p_world - u_eye;
    away /= max(length(away), 1e-20);
    vec3 direction = vec3(
        dot(placement_texel(row, 6).xyz, away),
        dot(placement_texel(row, 7).xyz, away),
        dot(placement_texel(row, 8).xyz, away));
    vec4 plain = vec4(sh_color(id, direction), 1.0);
    vec3 color = vec3(
        dot(placement_texel(row, 3), plain),
        dot(placement_texel(row, 4), plain),
        dot(placement_texel(row, 5), plain));
    color = vec3(  // not finite is black; NaN fails every comparison
        color.r > 0.0 && color.r < 1e30 ? color.r : 0.0,
        color.g > 0.0 && color.g < 1e30 ? color.g : 0.0,
        color.b > 0.0 && color.b < 1e30 ? color.b : 0.0);
    if (u_mode == 1) {
        float light = clamp(dot(color, vec3(0.299, 0.587, 0.114)), 0.0, 1.0);
        color = texelFetch(u_palette, texel_of(label), 0).rgb * (0.62 + 0.62 * light);
    }
    color = min(color / COLOR_RANGE, 1.0);
    o_look.yz = uvec2(pack_unit(color.rg), pack_unit(vec2(color.b, opacity)));
}
