"""The stored pose graph of a map: tracks, frames, edits, and when it is optimised."""
