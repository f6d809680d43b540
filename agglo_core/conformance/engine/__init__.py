"""Running laws and judging by them: in processes of their own, in pytest, for the documentation."""
