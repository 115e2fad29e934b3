"""What is shown of an artifact: which looks it has, and each look as a picture, model, table or curve."""
