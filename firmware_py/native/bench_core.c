/* The bench's bus and logs in C, as one extension module of Python. */
#include "bus.h"

static PyObject *core_use(PyObject *module, PyObject *args, PyObject *named)
{
    static char *names[] = {"frame",      "counters", "statistics", "frame_bits",
                            "field_text", "enum_type", NULL};
    PyObject **places[] = {&frame_type,        &counters_type, &statistics_type,
                           &python_frame_bits, &field_text,    &enum_type};
    PyObject *given[6];
    if (!PyArg_ParseTupleAndKeywords(args, named, "$OOOOOO", names, &given[0], &given[1],
                                     &given[2], &given[3], &given[4], &given[5]))
        return NULL;
    for (int at = 0; at < 6; at++)
        Py_XSETREF(*places[at], Py_NewRef(given[at]));
    Py_RETURN_NONE;
}

static PyObject *core_frame_bits(PyObject *module, PyObject *args)
{
    unsigned id;
    Py_buffer data;
    if (!PyArg_ParseTuple(args, "Iy*", &id, &data))
        return NULL;
    PyObject *bits = NULL;
    if (id < 2048 && data.len <= 8)
        bits = PyLong_FromLong(frame_bits(id, data.buf, (unsigned)data.len));
    else
        PyErr_SetString(PyExc_ValueError, "no classic frame");
    PyBuffer_Release(&data);
    return bits;
}

static PyMethodDef methods[] = {
    {"use", (PyCFunction)(void (*)(void))core_use, METH_VARARGS | METH_KEYWORDS,
     "Take the classes and functions of Python that this module calls."},
    {"frame_bits", core_frame_bits, METH_VARARGS, NULL},
    {NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "bench_core", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_bench_core(void)
{
    PyTypeObject *types[] = {&CandumpLinesType, &CsvLinesType, &PortLinesType, &PortType, &BusType};
    PyObject *module = PyModule_Create(&definition);
    fill_frame_tables();
    for (size_t at = 0; module && at < sizeof types / sizeof *types; at++)
        if (PyModule_AddType(module, types[at]) < 0)
            Py_CLEAR(module);
    return module;
}
