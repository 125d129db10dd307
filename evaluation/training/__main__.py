"""`python -m revisit.evaluation.training`: train the shipped models. See `evaluation.training.command`."""

from revisit.evaluation.training.command import main

main()
