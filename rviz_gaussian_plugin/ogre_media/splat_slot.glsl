// The slots of an arena, as packed_slot.hpp lays them out.
layout(std430) readonly buffer Slots { uint slots[]; };

vec3 slotPosition(uint slot) {
  uint i = 9u * slot;
  return uintBitsToFloat(uvec3(slots[i], slots[i + 1u], slots[i + 2u]));
}

float slotOpacity(uint slot) { return float(slots[9u * slot + 3u] & 0xffffu) / 65535.0; }

vec3 slotScale(uint slot) {
  uint i = 9u * slot + 3u;
  uvec3 code = uvec3(slots[i] >> 16, slots[i + 1u] & 0xffffu, slots[i + 1u] >> 16);
  return mix(exp2(-40.0 + 64.0 / 65534.0 * (vec3(code) - 1.0)), vec3(0.0), equal(code, uvec3(0u)));
}

vec4 slotRotation(uint slot) {
  uint i = 9u * slot + 5u;
  int low = int(slots[i]), high = int(slots[i + 1u]);
  vec3 smallest = vec3(bitfieldExtract(low, 2, 15), bitfieldExtract(low, 17, 15),
                       bitfieldExtract(high, 0, 15)) * (0.70710678118654752 / 16383.0);
  float largest = sqrt(max(1.0 - dot(smallest, smallest), 0.0));
  switch (low & 3) {
    case 0: return vec4(largest, smallest);
    case 1: return vec4(smallest.x, largest, smallest.yz);
    case 2: return vec4(smallest.xy, largest, smallest.z);
    default: return vec4(smallest, largest);
  }
}

vec3 slotColour(uint slot) {  // band 0
  uint i = 9u * slot + 7u;
  return vec3(unpackHalf2x16(slots[i]), unpackHalf2x16(slots[i + 1u]).x);
}

float slotHarmonicsUnit(uint slot) { return unpackHalf2x16(slots[9u * slot + 6u] >> 16).x; }

// Time since the slot last changed [s]; now: quarter seconds, modulo 2^16 as those of the slots.
float slotAge(uint slot, float now) {
  return 0.25 * mod(now - float(slots[9u * slot + 8u] >> 16), 65536.0);
}
