"""What a command answers: facts as JSON, the verdict as a sentence, and one self-contained HTML page."""
