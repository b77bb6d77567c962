// Data textures are 2048 texels wide: row i of a column lies at (i % 2048, i / 2048).
ivec2 texel_of(int i) { return ivec2(i & 2047, i >> 11); }

// Two 16-bit fixed-point numbers in 0..1 in one word, and back (packUnorm2x16 is not in GLSL 3.30).
vec2 unpack_unit(uint word) { return vec2(word & 0xffffu, word >> 16) * (1.0 / 65535.0); }
uint pack_unit(vec2 value)
{
    uvec2 word = uvec2(clamp(value, 0.0, 1.0) * 65535.0 + 0.5);
    return word.x | (word.y << 16);
}

// Two lengths in pixels as halfs in one word, up to a million and down to a thousandth, and back.
uint half_of(float value)
{
    uint bits = floatBitsToUint(abs(value) * 0.0625);
    uint short_bits = bits < 0x38800000u ? 0u : min(((bits + 0x1000u) >> 13) - 0x1c000u, 0x7bffu);
    return short_bits | (value < 0.0 ? 0x8000u : 0u);
}
float of_half(uint word)
{
    uint bits = word & 0x7fffu;
    float value = bits == 0u ? 0.0 : uintBitsToFloat((bits << 13) + 0x38000000u) * 16.0;
    return (word & 0x8000u) != 0u ? -value : value;
}
uint pack_lengths(vec2 value) { return half_of(value.x) | (half_of(value.y) << 16); }
vec2 unpack_lengths(uint word) { return vec2(of_half(word & 0xffffu), of_half(word >> 16)); }

const float COLOR_RANGE = 8.0;  // colors travel as fixed point in 0..COLOR_RANGE
const uint SELECTED = 1u;       // bits of gaga_core State
const uint HIDDEN = 2u;
const uint DELETED = 8u;

const float LEAST_SHARE = 0.35; // of marked splats in a pixel, up to which it has no outline
