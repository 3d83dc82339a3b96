"""Orders the splats of a 3D Gaussian map by depth for each view that looks at it."""
