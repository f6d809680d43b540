"""Base classes of the conformance tests: test case, law, failure, and component under test."""
