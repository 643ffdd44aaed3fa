"""Output for people: tables, pictures, pages and texts.

Contents: text, pages and pictures made of solutions and rows. Not here: mathematics that a solution needs, and options
of the command line.
"""
