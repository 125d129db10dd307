"""The place index of this process: searched, loaded, kept in files."""
