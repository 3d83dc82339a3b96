// For programs that draw shares of splats, where nodes stand for what is left of them.
#define SHARES
layout(std430) readonly buffer Shares { float shares[]; };
