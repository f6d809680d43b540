"""Command output: tables, notices, JSON, files."""
