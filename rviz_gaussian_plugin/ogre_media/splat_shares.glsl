// For programs that draw only a share of each splat: nodes stand for the rest.
#define SHARES
layout(std430) readonly buffer Shares { float shares[]; };
