// For programs that also draw solid balls.
#define BALLS
