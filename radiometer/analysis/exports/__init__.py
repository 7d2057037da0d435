"""Maps and curves written in the forms of other programs."""
