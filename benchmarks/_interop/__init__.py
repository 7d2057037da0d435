"""Other people's programs, too heavy for the tests: `make interop` runs them in an environment of their own."""
