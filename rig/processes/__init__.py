"""How a program ends, how it starts another one, and how much memory it may use."""
