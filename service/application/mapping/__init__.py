"""Maps as one: versions of their poses, corrections of sessions, decisions on loops."""
