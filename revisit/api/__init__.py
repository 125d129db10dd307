"""The API: the one list of calls, their scopes, and their HTTP form."""
