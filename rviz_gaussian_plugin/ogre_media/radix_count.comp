// How often each digit occurs in each block of the keys: counts[digit * blocks + block].

layout(local_size_x = 256) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 4) writeonly buffer Counts { uint counts[]; };

uniform uint count, blocks, shift;

shared uint histogram[256];

void main() {
  uint local = gl_LocalInvocationIndex, block = workGroup();
  if (block >= blocks) return;
  histogram[local] = 0u;
  barrier();
  for (uint k = 0u; k < kKeysEach; ++k) {
    uint i = (block * kKeysEach + k) * 256u + local;
    if (i < count) atomicAdd(histogram[(keys[i] >> shift) & 255u], 1u);
  }
  barrier();
  counts[local * blocks + block] = histogram[local];
}
