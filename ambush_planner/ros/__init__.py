"""The node: parameters, conversions, transforms, requests, diagnostics."""
