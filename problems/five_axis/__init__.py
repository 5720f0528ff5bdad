"""Five-axis simulator: plumb, squareness, intersection and alignment of its axes from a level and two theodolites.

The paper's procedure step by step (`step_by_step`) and all of its readings as one world (`joint`); `reproduce` compares
both with every printed number.
Source: Ren Shunqing, Gao Kang, Zhao Hongbo, J. Harbin Inst. Tech. 47(10), 2015, 1-6, doi
10.11918/j.issn.0367-6234.2015.10.001.
"""

from .adjustment import advice
from .comparison import NAME as published
from .comparison import reproduce
from .jobs import accepts, columns, declare, effects, example, example_job, formulations, from_job, options, remarks

source = "Ren, Gao, Zhao (2015), J. Harbin Inst. Tech. 47(10), 1-6"
__all__ = [
    "accepts", "advice", "columns", "declare", "effects", "example", "example_job", "formulations", "from_job",
    "options", "published", "remarks", "reproduce", "source"]
