"""Tables: their format, the printed numbers, and one module per kind."""
