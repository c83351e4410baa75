from .finding import Finding as Finding
from .led_test import SelfTest as SelfTest
from .led_test import selftest as selftest
