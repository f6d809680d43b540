"""The tables: their form, the printed numbers, and one module for each kind."""
