# Copyright 2025 ROSplat developers
# SPDX-License-Identifier: Apache-2.0
"""Orders the splats of a 3D Gaussian map by depth for each view that looks at it."""
