"""A small data set in the layout of UTIAS MRCLAM."""

FILES = {
    "Barcodes.dat": "  1 \t 5 \r\n  6 \t 63 \r\n  7 \t 81 \r\n",
    "Landmark_Groundtruth.dat": "  6 \t 2.0 \t 1.0 \t 0.01 \t 0.02 \r\n  7 \t 3.0 \t -1.0 \t 0.03 \t 0.04 \r\n",
    "Robot2_Groundtruth.dat": "10.000\t1.0\t0.5\t0.0\r\n12.000\t1.2\t0.5\t0.0\r\n",
    "Robot2_Odometry.dat": "9.5\t0.1\t0.0\r\n10.5\t0.2\t0.1\r\n10.5\t0.1\t0.0\r\n13.0\t0.0\t0.0\r\n",
    "Robot2_Measurement.dat": (
        "9.000\t63\t1.0\t0.1\r\n10.500\t63\t1.118\t0.4636\r\n10.500\t5\t1.0\t-0.2\r\n"
        "10.500\t99\t1.0\t-0.3\r\n11.250\t81\t2.5\t-0.7\r\n12.500\t63\t1.0\t0.1\r\n"
    ),
}
