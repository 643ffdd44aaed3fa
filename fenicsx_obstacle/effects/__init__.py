"""One class for each physical effect a scene can name; nothing else is ever assembled."""
