"""The contracts that plugins fulfil: one abstract base class a kind, one module each."""
