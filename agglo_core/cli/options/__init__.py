"""Options and arguments of commands: parsing, checks, completion in the shell."""
