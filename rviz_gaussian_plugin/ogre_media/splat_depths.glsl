// For programs that find or blend the splats' depths [m].
#define DEPTHS
// By how much the plane of each ellipse, on which its density is largest along a ray, is farther a pixel to the right and
// a pixel down, to first order. 0 of rays and discs. [m/px]
layout(std430) buffer Planes { vec2 planes[]; };
