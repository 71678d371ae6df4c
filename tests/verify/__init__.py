"""Laws and truths that a user can have checked: `make verify` (docs/verify.md).

It stands beside the tests, since `lib/` knows no tests, and uses their small scenes. tests/test_verify.py asks the same
laws place by place, so each stands once.
"""
