"""Output of commands: tables, notes and warnings, JSON, files."""
