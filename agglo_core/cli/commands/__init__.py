"""Commands of ``agglo``, one module each."""
