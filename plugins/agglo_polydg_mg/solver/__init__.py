"""Default solver ``polydg_mg``, and the rules by which it chooses its multigrid levels."""
