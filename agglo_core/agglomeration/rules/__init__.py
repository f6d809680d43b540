"""Rules for parts: from keywords to constraints, edges that no part crosses, demands on whole parts."""
