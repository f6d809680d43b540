"""Options and arguments of commands: parsing, checks, tab completion in the shell."""
