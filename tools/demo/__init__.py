"""The program that draws the demo scene in ``assets/demo``."""
