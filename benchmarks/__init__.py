"""Long measurements of accuracy and speed, each beside a peer in the same run; never part of the test suite."""
