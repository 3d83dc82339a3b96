// For programs that find depths of surfaces instead of mean depths: of the splat that leaves half of the light or less.
#define MEDIAN
