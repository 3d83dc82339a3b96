// For programs that must find the same tiles as one another: of another program's results GLSL
// promises nothing otherwise.
#define EXACTLY precise
