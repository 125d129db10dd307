"""`python -m evaluation.training`: train the shipped models. See `evaluation.training.command`."""

from evaluation.training.command import main

main()
