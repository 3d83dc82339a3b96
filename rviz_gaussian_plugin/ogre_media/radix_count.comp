// How often each digit occurs in each block of the keys: counts[digit * blocks + block].

#pragma optionNV(unroll all)  // or NVIDIA's compiler keeps arrays in memory instead of registers

layout(local_size_x = 512) in;
layout(std430) readonly buffer Keys { uint keys[]; };
layout(std430) writeonly buffer Counts { uint counts[]; };
layout(std430) readonly buffer Length { Tally keys_tally; };

const uint kLanes = 512u, kEach = kBlock / kLanes;

shared uint histogram[256];

void main() {
  uint local = gl_LocalInvocationIndex, block = workGroup(), count = keys_tally.count;
  uint blocks = (count + kBlock - 1u) / kBlock;
  if (block >= blocks) return;
  if (local < 256u) histogram[local] = 0u;
  barrier();
  uint first = block * kBlock + local, key[kEach];  // read before anything waits for them
  for (uint k = 0u; k < kEach; ++k) key[k] = keys[min(first + kLanes * k, count - 1u)];
  for (uint k = 0u; k < kEach; ++k) {
    if (first + kLanes * k < count) atomicAdd(histogram[digitOf(key[k])], 1u);
  }
  barrier();
  if (local < 256u) counts[local * blocks + block] = histogram[local];
}
