// Data textures are 2048 texels wide: row i of a column lies at (i % 2048, i / 2048).
ivec2 texel_of(int i) { return ivec2(i & 2047, i >> 11); }

// Two 16-bit fixed-point numbers in 0..1 in one word, and back (packUnorm2x16 is not in GLSL 3.30).
vec2 unpack_unit(uint word) { return vec2(word & 0xffffu, word >> 16) * (1.0 / 65535.0); }
uint pack_unit(vec2 value)
{
    uvec2 word = uvec2(clamp(value, 0.0, 1.0) * 65535.0 + 0.5);
    return word.x | (word.y << 16);
}

const float COLOR_RANGE = 8.0;  // colors travel as fixed point in 0..COLOR_RANGE
const uint SELECTED = 1u;       // bits of gaga_core State
const uint HIDDEN = 2u;
const uint DELETED = 8u;
