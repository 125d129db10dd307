"""What a client can say: the one list of calls, the scopes that they need, and their HTTP form."""
