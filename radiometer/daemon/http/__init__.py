"""HTTP: history, streams, pictures, figures, and a web page."""
