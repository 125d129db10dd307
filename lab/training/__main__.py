"""`python -m lab.training`: train the shipped models. See `lab.training.command`."""

from lab.training.command import main

main()
