"""The suite; a package so that helper modules of its own can be imported by their full name."""
