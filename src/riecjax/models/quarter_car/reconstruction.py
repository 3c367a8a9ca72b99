from riecjax.models.quarter_car.curves import *
