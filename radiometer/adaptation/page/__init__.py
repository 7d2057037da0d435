"""The page of the running test, for a dark room."""
