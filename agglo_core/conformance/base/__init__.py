"""What a law is made of: case, law, verdict, the component under test."""
