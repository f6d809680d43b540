"""How wheels are built; nothing here runs later."""
