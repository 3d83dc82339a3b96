// How often each digit occurs in each block of the keys: counts[digit * blocks + block].

layout(local_size_x = 256) in;
layout(std430) readonly buffer Keys { uint keys[]; };
layout(std430) writeonly buffer Counts { uint counts[]; };
layout(std430) readonly buffer Length { Tally keys_tally; };


shared uint histogram[256];

void main() {
  uint local = gl_LocalInvocationIndex, block = workGroup(), count = keys_tally.count;
  uint blocks = (count + kBlock - 1u) / kBlock;
  if (block >= blocks) return;
  histogram[local] = 0u;
  barrier();
  for (uint k = 0u; k < kBlock; k += 256u) {
    uint i = block * kBlock + k + local;
    if (i < count) atomicAdd(histogram[digitOf(keys[i])], 1u);
  }
  barrier();
  counts[local * blocks + block] = histogram[local];
}
