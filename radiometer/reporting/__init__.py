"""The skeleton, the words of numbers and the pictures that all HTML reports share."""
