from .audit.audit import audit as audit
from .calibration import (
    Calibration as Calibration,
    calibrate as calibrate,
    read_calibration as read_calibration,
    write_calibration as write_calibration,
)
from .comparison import compare as compare
from .effects import (
    model_effects as model_effects,
    printed_effects as printed_effects,
    simulated_effects as simulated_effects,
)
from .published import (
    published_models as published_models,
    published_table as published_table,
    verdicts as verdicts,
)
from .published_study import (
    PublishedStudy as PublishedStudy,
    PublishedStudyError as PublishedStudyError,
    published_studies as published_studies,
)
from .reconstruction.feasibility import (
    Feasibility as Feasibility,
    ReconstructionError as ReconstructionError,
    feasibility as feasibility,
    reconstruct as reconstruct,
)
