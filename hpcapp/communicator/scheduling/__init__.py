"""What the master decides: who may work, who gets which task, and whose answers are believed."""
