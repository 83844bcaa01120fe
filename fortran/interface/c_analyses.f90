!> C interface: analyses of systems.
module viscovib_c_analyses
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_double, c_f_pointer, c_int, &
    c_loc, c_null_char, c_null_ptr, c_ptr
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_amplitude_spectrum, only: amplitude_spectrum
  use viscovib_fourier, only: check_length
  use viscovib_c_systems, only: c_system, numbers_text, read_call, result_place, &
    system_of, text_of, description
  use viscovib_job, only: job_report
  use viscovib_kept_result, only: kept_result, new_text
  use viscovib_kinds, only: wp
  use viscovib_run_scene, only: plan_scene
  use viscovib_scene, only: scene_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_stopping, only: want_stop
  use viscovib_version, only: version
  use viscovib_windows, only: window_names
  implicit none
  private

  character(len=*), parameter :: nl = new_line('a')
  !> As in include/viscovib.h.
  integer(c_int), parameter :: this_interface = 1
  !> Largest lengths of a list in a scene and of a signal.
  integer, parameter :: max_values = 1000000, max_signal = 2**28
  character(kind=c_char, len=*), parameter :: version_text = version//c_null_char
  character(kind=c_char, len=len(version_text)), target :: kept_version = version_text

contains

  integer(c_int) function interface_number() bind(c, name='viscovib_interface')
    interface_number = this_interface
  end function interface_number

  type(c_ptr) function library_version() bind(c, name='viscovib_version')
    library_version = c_loc(kept_version)
  end function library_version

  !> Run the analysis that groups define. Returns the handle of the result.
  subroutine compute(groups, handle, status)
    character(len=*), intent(in) :: groups
    type(c_ptr), intent(out) :: handle
    type(status_type), intent(out) :: status
    type(scene_type), target :: scene
    type(kept_result), pointer :: result
    type(job_report) :: report
    character(len=:), allocatable :: plan

    handle = c_null_ptr
    call read_call(groups, scene, status)
    if (.not. status%failed()) call plan_scene(scene, plan, status)
    if (status%failed()) return
    allocate (result)
    allocate (result%tables(0))
    call scene%job%run(scene%subject, result, report, status)
    if (status%failed()) then
      deallocate (result)
      return
    end if
    result%summary = new_text(report%summary)
    result%warnings = new_text(scene%subject%warnings())
    result%complete = report%complete
    handle = c_loc(result)
  end subroutine compute

  !> Like `compute`, for a system and one more group.
  integer(c_int) function computed(system_handle, group, place)
    type(c_ptr), intent(in) :: system_handle, place
    character(len=*), intent(in) :: group
    type(c_ptr), pointer :: handle
    type(c_system), pointer :: system
    type(status_type) :: status

    call result_place(place, handle, status)
    if (.not. status%failed()) call system_of(system_handle, system, status)
    if (.not. status%failed()) call compute(system%text//group//' /'//nl, handle, status)
    computed = description(status)
  end function computed

  integer(c_int) function response(system, method, n, nu, keys, result) &
    bind(c, name='viscovib_response')
    type(c_ptr), value :: system, method, nu, keys, result
    integer(c_int), value :: n
    type(c_ptr), pointer :: handle
    real(c_double), pointer :: values(:)
    type(status_type) :: status

    call result_place(result, handle, status)
    if (.not. status%failed()) then
      if (n < 1 .or. .not. c_associated(nu)) then
        call fail(status, status_input_error, 'nu', 'nu: must be one or more frequencies, n = ' &
                  //show(int(n)))
      else if (n > max_values) then
        call fail(status, status_input_error, 'n', 'n = '//show(int(n))//': must be at most ' &
                  //show(max_values)//' frequencies')
      end if
    end if
    if (status%failed()) then
      response = description(status)
      return
    end if
    call c_f_pointer(nu, values, [n])
    response = computed(system, "&response method = '"//text_of(method)//"'," &
                        //numbers_text('nu', values)//' '//text_of(keys), result)
  end function response

  integer(c_int) function branch(system, nu_from, nu_to, keys, result) &
    bind(c, name='viscovib_branch')
    type(c_ptr), value :: system, keys, result
    real(c_double), value :: nu_from, nu_to
    branch = computed(system, '&branch'//numbers_text('nu_from', [nu_from]) &
                      //numbers_text('nu_to', [nu_to])//' '//text_of(keys), result)
  end function branch

  integer(c_int) function motion(system, nu, t_end, initial, keys, result) &
    bind(c, name='viscovib_motion')
    type(c_ptr), value :: system, initial, keys, result
    real(c_double), value :: nu, t_end
    type(c_ptr), pointer :: handle
    type(c_system), pointer :: moved
    type(status_type) :: status
    real(c_double), pointer :: values(:)
    character(len=:), allocatable :: group

    call result_place(result, handle, status)
    if (.not. status%failed()) call system_of(system, moved, status)
    if (status%failed()) then
      motion = description(status)
      return
    end if
    group = '&transient'//numbers_text('t_end', [t_end])
    ! A nonfinite value is rejected when the group is read.
    if (.not. ieee_is_finite(nu)) then
      group = group//numbers_text('nu', [nu])
    else if (abs(nu) > 0.0_wp) then
      group = group//numbers_text('nu', [nu])
    end if
    if (c_associated(initial)) then
      call c_f_pointer(initial, values, [2*moved%n_coordinates])
      group = group//numbers_text('initial', values)
    end if
    motion = computed(system, group//' '//text_of(keys), result)
  end function motion

  integer(c_int) function analyse(system, group, keys, result) bind(c, name='viscovib_analyse')
    type(c_ptr), value :: system, group, keys, result
    analyse = computed(system, '&'//text_of(group)//' '//text_of(keys), result)
  end function analyse

  integer(c_int) function run_text(scene, result) bind(c, name='viscovib_run')
    type(c_ptr), value :: scene, result
    type(c_ptr), pointer :: handle
    type(status_type) :: status
    call result_place(result, handle, status)
    if (.not. status%failed()) call compute(text_of(scene)//nl, handle, status)
    run_text = description(status)
  end function run_text

  integer(c_int) function spectrum(n, signal, window, real_part, imaginary_part) &
    bind(c, name='viscovib_spectrum')
    integer(c_int), value :: n, window
    type(c_ptr), value :: signal, real_part, imaginary_part
    real(c_double), pointer :: values(:), x(:), y(:)
    complex(wp), allocatable :: amplitudes(:)
    type(status_type) :: status

    if (n < 1 .or. n > max_signal) then
      call fail(status, status_input_error, 'n', 'n = '//show(int(n))//': must be 1 to ' &
                //show(max_signal)//' values')
    else if (window < 1 .or. window > size(window_names)) then
      call fail(status, status_input_error, 'window', 'window = '//show(int(window)) &
                //': must be 1 to '//show(size(window_names)))
    else if (.not. (c_associated(signal) .and. c_associated(real_part) &
                    .and. c_associated(imaginary_part))) then
      call fail(status, status_input_error, 'signal', 'signal, real, imaginary: must not be NULL')
    else
      call c_f_pointer(signal, values, [n])
      if (.not. all(ieee_is_finite(values))) then
        call fail(status, status_input_error, 'signal', 'signal: must be finite numbers')
      else
        call check_length(int(n), status)
      end if
      if (status%failed()) then
        spectrum = description(status)
        return
      end if
      call c_f_pointer(real_part, x, [n/2 + 1])
      call c_f_pointer(imaginary_part, y, [n/2 + 1])
      allocate (amplitudes(n/2 + 1))
      call amplitude_spectrum(values, int(window), amplitudes)
      x = real(amplitudes)
      y = aimag(amplitudes)
    end if
    spectrum = description(status)
  end function spectrum

  subroutine stop_loops(flag) bind(c, name='viscovib_stop_loops')
    integer(c_int), value :: flag
    call want_stop(flag /= 0_c_int)
  end subroutine stop_loops

end module viscovib_c_analyses
