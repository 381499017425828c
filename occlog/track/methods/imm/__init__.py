"""Method `imm`: several targets that microphone arrays hear, with cameras that are asked."""
