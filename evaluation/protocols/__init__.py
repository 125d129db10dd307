"""How recognition is judged: the same question put to every method.

towns      the simulated drives and their seeds
question   which submaps may answer, which answers are right
contest    all methods on one question
trial      the outcome, as numbers in a file
programme  which trials make up the bench
"""
