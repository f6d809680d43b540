"""Bilinear forms, loads, penalties and norms of the interior penalty method."""
