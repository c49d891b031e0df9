"""What GitHub's runner reads of a run: commands in the log, files of the step, a comment.

Sizes and limits are those of docs.github.com, *Workflow commands for GitHub Actions*: 1 MiB of step
summary, above which all of it is lost; 10 annotations of a kind and step, of which the rest vanish
without a word; 65,536 characters of a comment.
"""
