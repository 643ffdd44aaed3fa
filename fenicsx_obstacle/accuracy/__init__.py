"""What an answer is worth: error norms, contact sets, forces."""
