// For programs that blend the splats' depths [m] instead of colours.
#define DEPTHS
