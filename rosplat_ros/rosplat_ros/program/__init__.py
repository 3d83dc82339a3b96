"""How nodes and programs begin, speak, write and end."""
