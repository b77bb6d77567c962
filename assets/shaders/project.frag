// Projection, once per splat: fragment k of a 2048 wide target is the k-th splat of the depth order.
// The image model is the one of gaga_core/raster/base.py (3D Gaussian Splatting, Kerbl 2023).
uniform usampler2D u_order;        // splat of each rank
uniform sampler2D u_means;         // xyz
uniform usampler2D u_shape;        // 8 x 16 bit: quaternion wxyz, log scales, opacity
uniform sampler2D u_color;         // DC coefficients; scale of the others
uniform usampler2DArray u_sh;      // the others as shares of the scale, eight bytes a layer
uniform usampler2D u_state;
uniform isampler2D u_labels;
uniform usampler2D u_placement;
uniform usampler2D u_confidence;   // 0..255, in mode 3 only
uniform usampler2D u_identity;     // 3 x 8 bit: rgb of the encoding, in mode 7 and in mode 4
uniform usampler2D u_tint;         // 4 x 8 bit: rgb over the splat's own color, and its share
uniform sampler2D u_placements;    // 16 texels a row, 128 rows a line
uniform sampler2D u_palette;       // color of each label

uniform int u_count;               // splats in the order
uniform mat4 u_cam_from_world;
uniform vec3 u_eye;                // world
uniform vec4 u_lens;               // fx, fy, cx, cy in pixels of the target
uniform vec2 u_size;               // target in pixels
uniform vec2 u_log_scale;          // fixed point of log scales: low end, range
uniform int u_mode;                // 0 color, 1 groups, 2 depth, 3 confidence, 4 centres, 5 rings, 6 mask,
                                   // 7 identity
uniform int u_hovered;             // label, 0 = none
uniform int u_focus;               // label that is white in mode 6
uniform int u_tinted;              // 1: there is a u_tint
uniform int u_centre_colors;       // of centres: 0 their own, 1 of groups, 2 of identities
uniform int u_antialiased;         // 1: the blur of a picture takes as much opacity as it adds area
uniform float u_threshold;         // see importance() in sort_kernels.py
uniform float u_point;             // radius of a centre in pixels

// Of a splat that is not seen, all words are 0; of any other the opacity is not.
layout(location = 0) out uvec4 o_ellipse;  // centre (2 floats), long half-axis, (short one, opacity)
layout(location = 1) out uvec2 o_look;     // (r, g) or depth, (b, flags)

const float BLUR = 0.3;
const float ALPHA_MIN = 1.0 / 255.0;
const float MOST_GROWTH = 0.5;  // log of how much a splat grows that stands for others

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
    vec4 first = texelFetch(u_color, texel_of(id), 0);
    vec3 color = 0.5 + basis[0] * first.rgb;
#if N_SH > 1
    float shares[N_LAYERS * 8];
    for (int layer = 0; layer < N_LAYERS; ++layer) {
        uvec2 words = texelFetch(u_sh, ivec3(texel_of(id), layer), 0).rg;
        for (int k = 0; k < 4; ++k) {
            shares[layer * 8 + k] = float(int(words.x << (24 - 8 * k)) >> 24);
            shares[layer * 8 + 4 + k] = float(int(words.y << (24 - 8 * k)) >> 24);
        }
    }
    vec3 rest = vec3(0.0);
    for (int k = 0; k < N_SH - 1; ++k)
        rest += basis[k + 1] * vec3(shares[3 * k], shares[3 * k + 1], shares[3 * k + 2]);
    color += rest * (first.a / 127.0);
#endif
    return color;
}

// Red is unsure, blue is sure, with light yellow between: told apart by color-blind eyes too.
vec3 heat(float t)
{
    const vec3 low = vec3(0.84, 0.19, 0.12), middle = vec3(1.0, 0.93, 0.62), high = vec3(0.16, 0.42, 0.74);
    return t < 0.5 ? mix(low, middle, 2.0 * t) : mix(middle, high, 2.0 * t - 1.0);
}

void main()
{
    o_ellipse = uvec4(0u);
    o_look = uvec2(0u);
    int rank = int(gl_FragCoord.y) * 2048 + int(gl_FragCoord.x);
    if (rank >= u_count) return;
    int id = int(texelFetch(u_order, texel_of(rank), 0).r);
    ivec2 at = texel_of(id);
    uint state = texelFetch(u_state, at, 0).r;
    if ((state & (HIDDEN | DELETED)) != 0u) return;

    int row = int(texelFetch(u_placement, at, 0).r);
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
    float area = dot(log_scales, vec3(1.0)) - min(log_scales.x, min(log_scales.y, log_scales.z));
    float share = 0.5 * (area + log(max(tail.y, 1e-6))) - u_threshold;  // log of p
    log_scales += clamp(-0.5 * share, 0.0, MOST_GROWTH);
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
    if (u_antialiased != 0) opacity *= sqrt(dot(normal, normal) / det);
    if (u_mode == 4) {
        float variance = u_point * u_point;
        a = variance; b = 0.0; d = variance; det = variance * variance;
        opacity = 0.99;
    }
    if (!(opacity >= ALPHA_MIN)) return;
    float mid = 0.5 * (a + d);
    float long_variance = mid + length(vec2(0.5 * (a - d), b));
    float short_variance = det / long_variance;
    if (!(long_variance < 1e30 && short_variance > 0.0)) return;
    vec2 axis = a >= d ? vec2(long_variance - d, b) : vec2(b, long_variance - a);
    float axis_length = length(axis);
    axis = axis_length > 1e-12 ? axis / axis_length : vec2(1.0, 0.0);

    // The quad ends where alpha falls under 1/255.
    float reach = u_mode == 4 ? 1.0 : sqrt(2.0 * max(0.0, log(opacity * 255.0)));
    vec2 centre = focal * p_cam.xy * iz + u_lens.zw;
    vec2 box = reach * sqrt(vec2(a, d));
    if (any(lessThan(centre + box, vec2(0.0))) || any(greaterThan(centre - box, u_size))) return;

    int label = max(0, texelFetch(u_labels, at, 0).r);
    uint flags = ((state & SELECTED) != 0u ? 1u : 0u) | (label > 0 && label == u_hovered ? 2u : 0u);
    o_ellipse = uvec4(
        floatBitsToUint(centre),
        pack_lengths(axis * (reach * sqrt(long_variance))),
        half_of(reach * sqrt(short_variance)) | (pack_unit(vec2(opacity, 0.0)) << 16));
    if (u_mode == 2) {
        o_look = uvec2(floatBitsToUint(p_cam.z), flags << 16);
        return;
    }
    if (u_mode == 6) {
        vec2 white = vec2(label > 0 && label == u_focus ? 1.0 / COLOR_RANGE : 0.0);
        o_look = uvec2(pack_unit(white), pack_unit(vec2(white.x, 0.0)) | (flags << 16));
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
    float light = clamp(dot(color, vec3(0.299, 0.587, 0.114)), 0.0, 1.0);
    bool by_group = u_mode == 1 || (u_mode == 4 && u_centre_colors == 1);
    if (by_group) color = texelFetch(u_palette, texel_of(label), 0).rgb * (0.62 + 0.62 * light);
    if (u_mode == 3) {
        float sure = float(texelFetch(u_confidence, at, 0).r) / 255.0;
        color = (label > 0 ? heat(sure) : vec3(0.42)) * (0.62 + 0.62 * light);
    }
    if (u_mode == 7 || (u_mode == 4 && u_centre_colors == 2)) {
        uint word = texelFetch(u_identity, at, 0).r;
        color = vec3(uvec3(word, word >> 8, word >> 16) & 255u) / 255.0;
    }
    if (u_tinted != 0) {
        uint word = texelFetch(u_tint, at, 0).r;
        vec4 tint = vec4(uvec4(word, word >> 8, word >> 16, word >> 24) & 255u) / 255.0;
        color = mix(color, tint.rgb * (0.62 + 0.62 * light), tint.a);
    }
    if (u_mode >= 4 && u_mode < 7 && (flags & 1u) != 0u) color = vec3(0.36, 0.66, 1.0);
    color = min(color / COLOR_RANGE, 1.0);
    o_look = uvec2(pack_unit(color.rg), pack_unit(vec2(color.b, 0.0)) | (flags << 16));
}
