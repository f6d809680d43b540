"""The levels of a run: recursion, growth, direct partitions, lines, and the passes on finished levels."""
