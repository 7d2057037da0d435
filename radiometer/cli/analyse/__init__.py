"""Commands that analyse captures and archives."""
