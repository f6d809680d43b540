"""Rules for parts: constraint keywords, forbidden edges and bounds on whole parts."""
