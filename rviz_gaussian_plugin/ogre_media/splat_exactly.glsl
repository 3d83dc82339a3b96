// For programs that must find the same tiles as each other: without `precise`, GLSL doesn't promise that two
// programs compute the same.
#define EXACTLY precise
