// For programs that also draw what is behind the scene's translucent objects.
#define BEHIND
