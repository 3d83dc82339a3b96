"""The laboratory: the error of every way to draw a map against its time, and where pictures fail.

`ways` lists what is compared, `measure` measures it, `points` finds what pays; `picture`, `report`
and `pages` show it. `atlas` looks for failures.
"""
