// The projected splats, in several parts if the driver's largest buffer can't hold all.
layout(std430) buffer Ellipses { uvec4 data[]; } ellipses[PARTS];

#ifdef RAYS
const uint kEllipseWords = 3u;  // of 16 bytes
#else
const uint kEllipseWords = 2u;
#endif
const uint kPartSize = PART_BYTES / (16u * kEllipseWords);

// The index of a buffer in an array must be a constant, or the same for all invocations.
#define IN_ITS_PART(DO)                     \
  uint k = kEllipseWords * (i % kPartSize); \
  switch (i / kPartSize) {                  \
    case 0u: DO(0);                         \
    case 1u: DO(1 % PARTS);                 \
    case 2u: DO(2 % PARTS);                 \
    default: DO(PARTS - 1);                 \
  }
#ifdef RAYS
#define READ(PART) return unpackEllipse(PackedEllipse(ellipses[PART].data[k], ellipses[PART].data[k + 1u], \
                                                      ellipses[PART].data[k + 2u]))
#define WRITE(PART)                    \
  ellipses[PART].data[k] = e.a;        \
  ellipses[PART].data[k + 1u] = e.b;   \
  ellipses[PART].data[k + 2u] = e.c;   \
  break
#else
#define READ(PART) return unpackEllipse(PackedEllipse(ellipses[PART].data[k], ellipses[PART].data[k + 1u]))
#define WRITE(PART) ellipses[PART].data[k] = e.a; ellipses[PART].data[k + 1u] = e.b; break
#endif

Ellipse ellipse(uint i) { IN_ITS_PART(READ) }

void storeEllipse(uint i, PackedEllipse e) { IN_ITS_PART(WRITE) }
