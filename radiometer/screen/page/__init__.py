"""The full-screen page that shows patches in any browser."""
