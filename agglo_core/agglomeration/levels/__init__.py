"""Level construction: recursion, growth, direct partitions, lines and post-passes."""
