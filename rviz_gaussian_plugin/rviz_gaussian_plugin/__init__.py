"""The splat renderer of the rviz2 Display, for Python. Its modules are private."""
