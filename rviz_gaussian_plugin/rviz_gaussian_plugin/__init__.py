"""The splat renderer of the rviz2 Display, for Python, a viewer and a demo.

The modules are private; the programs are public.
"""

__all__: list[str] = []
