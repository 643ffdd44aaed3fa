"""Invalid files and command lines of every kind, and the words that their messages must contain."""
