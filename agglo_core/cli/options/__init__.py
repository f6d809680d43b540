"""Options and arguments of commands: parsing, checks, shell completion."""
