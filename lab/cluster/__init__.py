"""What engines of many machines can do, measured."""
