"""What studies are made of, and what they share: options, tables, bars, scenes."""
