"""From a scene to an answer: the choice of solver, the frozen result, the saved folder."""
