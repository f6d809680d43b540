"""Result tables: their format, the published numbers, and one module per kind of table."""
