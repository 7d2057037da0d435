"""Long measurements of accuracy and speed, each next to a peer in the same run; never part of the test suite."""
