"""Output for people: tables, pictures, pages and texts.

Enters: what turns answers and rows into text, files for reading and pictures. Stays out: mathematics that an answer
needs, and options of the command line.
"""
