"""Relocalisation: a conversation with a robot that moves about where in a map it is."""
