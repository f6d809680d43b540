"""Output of commands: tables, notices, JSON, files."""
