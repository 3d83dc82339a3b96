// The projected splats, in several parts if the driver's largest buffer can't hold all.
layout(std430) buffer Ellipses { uvec4 data[]; } ellipses[PARTS];

// The index of a buffer in an array must be a constant, or the same for all invocations.
#define IN_ITS_PART(DO)          \
  uint k = 2u * (i % PART_SIZE); \
  switch (i / PART_SIZE) {       \
    case 0u: DO(0);              \
    case 1u: DO(1 % PARTS);      \
    case 2u: DO(2 % PARTS);      \
    default: DO(PARTS - 1);      \
  }
#define READ(PART) return unpackEllipse(PackedEllipse(ellipses[PART].data[k], ellipses[PART].data[k + 1u]))
#define WRITE(PART) ellipses[PART].data[k] = e.a; ellipses[PART].data[k + 1u] = e.b; break

Ellipse ellipse(uint i) { IN_ITS_PART(READ) }

void keep(uint i, PackedEllipse e) { IN_ITS_PART(WRITE) }
