!> Skipped computations of a plan are really skipped: each scene is run with the part skipped and
!! with a twin that needs it, and the operations are counted. Only the debug build counts.
module test_skips
  use test_scene_files, only: scratch
  use testing, only: begin, check, check_ok
  use viscovib_counters, only: counted, counted_accelerations, counted_base, counted_columns, &
    counted_coordinates, counted_corrections, counted_deflections, counted_even, counted_forces, &
    counted_fourier, counted_idle, counted_loads, counted_memory, counted_monomials, &
    counted_panels, counted_runs, counted_sines, counted_states, counted_transforms, &
    counted_turns, counted_unknowns, counter_names, counting, reset_counters
  use viscovib_forced_response, only: forced_response
  use viscovib_kinds, only: i8, wp
  use viscovib_response, only: response_options, response_type
  use viscovib_response_job, only: response_job
  use viscovib_response_plan, only: method_newton, method_successive, new_response_plan, &
    response_plan_type
  use viscovib_run_scene, only: plan_scene, run_scene, scene_report
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: run_skips

  character(len=*), parameter :: nl = new_line('a'), slash = nl//'/'//nl
  character(len=*), parameter :: body = &
    '&mount'//nl//'mass = 1'//nl//'inertia = 0.1'//nl//'offset = 0.5'//nl//'stiffness_x = 10' &
    //nl//'stiffness_phi = 2'//nl//'damping = 0.2 -0.1 -0.1 0.09'//nl
  character(len=*), parameter :: mount = body//slash, linear_mount = body//'cubic_scale = 0'//slash
  character(len=*), parameter :: kernel = &
    '&kernel'//nl//"kind = 'rzhanitsyn'"//nl//'amplitude = 0.048'//nl//'alpha = 0.1'//nl &
    //'beta = 0.05'//slash
  character(len=*), parameter :: silent_kernel = &
    '&kernel'//nl//"kind = 'rzhanitsyn'"//nl//'amplitude = 0'//nl//'alpha = 0.1'//nl &
    //'beta = 0.05'//slash
  character(len=*), parameter :: load = '&load'//nl//'amplitude = 0.02'//slash
  character(len=*), parameter :: response = '&response'//nl//'nu = 0.7 1.3'
  character(len=*), parameter :: newton = response//nl//"method = 'newton'"
  character(len=*), parameter :: motion = '&transient'//nl//'t_end = 6'//nl//'dt = 0.5'//nl &
                                          //'nu = 1.3'
  character(len=*), parameter :: rest = nl//'initial = 0 0 0 0'
  character(len=*), parameter :: swing = &
    '&pendulum'//nl//'e = 0.06'//nl//'w2 = 0.27'//nl//'w3 = 0.18'//nl//'alpha = 1.2'//nl &
    //'f0 = 0.01'//nl//'p1 = 1.4'//nl
  character(len=*), parameter :: swing_motion = '&transient'//nl//'t_end = 20'//nl//'dt = 0.5' &
                                                //nl
  !> Two oscillators, coupled by the text inserted for the spring only.
  character(len=*), parameter :: pair = &
    '&system'//nl//"coordinates = 'a' 'b'"//nl//'mass = 1 2'//nl//'damping = 0.1 0.1'//nl &
    //'stiffness = '

contains

  subroutine run_skips()
    if (.not. counting) return
    call nonlinear_terms()
    call memory()
    call symmetry()
    call idle_coordinates()
    call outputs()
    call zeros()
  end subroutine run_skips

  !> Run a scene and count. If given, the plan must state the reason of the skip.
  function work(text, reason) result(counts)
    character(len=*), intent(in) :: text
    character(len=*), intent(in), optional :: reason
    integer(i8) :: counts(size(counter_names))
    type(scene_type) :: scene
    type(scene_report) :: report
    type(status_type) :: status
    character(len=:), allocatable :: plan
    integer :: i

    counts = -1
    call read_scene('skips.nml', scene, status, text)
    call check_ok(status)
    if (status%failed()) return
    call plan_scene(scene, plan, status)
    call check_ok(status)
    if (present(reason)) call check(index(plan, reason) > 0, 'the plan says "'//reason//'": '//plan)
    call reset_counters()
    call run_scene(scene, scratch('skips'), 'test', report, status)
    call check_ok(status)
    counts = [(counted(i), i=1, size(counts))]
  end function work

  !> Frequencies of a scene with a response.
  function frequencies(scene) result(nu)
    type(scene_type), intent(in) :: scene
    real(wp), allocatable :: nu(:)
    associate (job => scene%job)
      select type (job)
      type is (response_job)
        nu = job%nu
      end select
    end associate
  end function frequencies

  !> The twin does the work, the skipping scene none of it.
  subroutine compare(skipping, twin, kinds)
    integer(i8), intent(in) :: skipping(:), twin(:)
    integer, intent(in) :: kinds(:)
    integer :: i
    do i = 1, size(kinds)
      call check(skipping(kinds(i)) == 0, trim(counter_names(kinds(i)))//' skipped, not ' &
                 //show(int(skipping(kinds(i)))))
      call check(twin(kinds(i)) > 0, trim(counter_names(kinds(i)))//' in the twin')
    end do
  end subroutine compare

  subroutine nonlinear_terms()
    if (begin('a linear scene evaluates no nonlinear force and iterates nowhere')) then
      call compare(work(linear_mount//load//response//slash, 'skips: the iteration'), &
                   work(mount//load//response//slash), &
                   [counted_deflections, counted_turns])
      call compare(work(linear_mount//load//newton//slash, 'skips: the iteration'), &
                   work(mount//load//newton//slash), &
                   [counted_deflections, counted_turns])
      call compare(work(linear_mount//kernel//load//motion//slash, 'skips: iteration in each'), &
                   work(mount//kernel//load//motion//slash, 'computes: nonlinear forces'), &
                   [counted_deflections, counted_turns])
    end if

    if (begin('only the exact geometry takes sines, and forces of displacement and memory')) then
      call compare(work(mount//load//response//slash, 'skips: hereditary variables in time'), &
                   work(body//"geometry = 'exact'"//slash//load//response//slash), &
                   [counted_sines, counted_forces])
    end if
  end subroutine nonlinear_terms

  subroutine memory()
    if (begin('without memory no kernel is transformed and no step remembered')) then
      call compare(work(mount//load//response//slash, 'skips: kernel transforms (no memory)'), &
                   work(mount//kernel//load//response//slash), [counted_transforms])
      call compare(work(mount//load//newton//slash, 'skips: kernel transforms (no memory)'), &
                   work(mount//kernel//load//newton//slash), [counted_transforms])
      call compare(work(mount//load//'&branch'//nl//'nu_from = 0.7'//nl//'nu_to = 0.9'//slash, &
                        'skips: kernel transforms (no memory)'), &
                   work(mount//kernel//load//'&branch'//nl//'nu_from = 0.7'//nl//'nu_to = 0.9' &
                        //slash), [counted_transforms])
      call compare(work(mount//load//motion//slash, 'skips: memory (no kernels)'), &
                   work(mount//kernel//load//motion//slash), [counted_memory])
    end if

    if (begin('from rest without load there are no panels of a start')) then
      call compare(work(mount//kernel//load//motion//slash, 'skips: fine steps'), &
                   work(mount//kernel//load//motion//nl//'initial = 0.1 0 0 0'//slash), &
                   [counted_panels])
    end if
  end subroutine memory

  subroutine symmetry()
    character(len=*), parameter :: mean = '&load'//nl//'order = 0'//nl//'amplitude = 0.001'//slash
    character(len=*), parameter :: branch = '&branch'//nl//'nu_from = 0.7'//nl//'nu_to = 0.9'

    if (begin('odd forces under a load of odd harmonics: no even unknowns')) then
      call compare(work(mount//load//response//slash, 'skips: even harmonics'), &
                   work(mount//load//mean//response//slash), [counted_even])
      call compare(work(mount//load//newton//slash, 'skips: even harmonics'), &
                   work(mount//load//mean//newton//slash), [counted_even])
      call compare(work(mount//load//branch//slash, 'skips: even harmonics'), &
                   work(mount//load//mean//branch//slash), [counted_even])
    end if
  end subroutine symmetry

  subroutine idle_coordinates()
    character(len=*), parameter :: apart = pair//'3 8'//slash//'&force'//nl//"on = 'a'"//nl &
                                           //"law = 'a^3'"//slash//'&force'//nl//"on = 'b'"//nl &
                                           //"law = 'b^2'"//slash
    character(len=*), parameter :: coupled = &
      pair//'3 -1e-9 -1e-9 8'//slash//'&force'//nl//"on = 'a'"//nl//"law = 'a^3'"//slash &
      //'&force'//nl//"on = 'b'"//nl//"law = 'b^2'"//slash
    character(len=*), parameter :: idle = 'skips: 1 coordinate at rest'
    integer(i8), allocatable :: skipping(:), twin(:)
    integer :: method

    if (begin('a coordinate neither loaded nor coupled has no unknowns')) then
      do method = method_successive, method_newton
        call respond(apart//load//response//slash, method, .false., skipping)
        call respond(apart//load//response//slash, method, .true., twin)
        call compare(skipping, twin, [counted_idle, counted_even])
        call check(4*skipping(counted_unknowns) <= twin(counted_unknowns), &
                   'half the coordinates, half the harmonics')
      end do
      skipping = work(apart//load//response//slash, idle)
      twin = work(coupled//load//response//slash)
      call compare(skipping, twin, [counted_even])
    end if

    if (begin('a force of both couples what springs do not')) then
      twin = work(pair//'3 8'//slash//'&force'//nl//"on = 'a'"//nl//"law = 'a*b^2'"//slash//load &
                  //response//slash)
      skipping = work(apart//load//response//slash, idle)
      call check(twin(counted_unknowns) == 2*skipping(counted_unknowns), 'both computed')
    end if

    if (begin('a coordinate at rest is not integrated in time')) then
      skipping = work(apart//load//motion//rest//slash, idle)
      twin = work(apart//load//motion//nl//'initial = 0 0 1e-200 0'//slash)
      call check(skipping(counted_coordinates) == skipping(counted_accelerations), 'one')
      call check(twin(counted_coordinates) == 2*twin(counted_accelerations), 'both')
      ! With memory, because each step counts.
      skipping = work(apart//kernel//load//motion//slash, idle)
      twin = work(apart//kernel//load//motion//nl//'initial = 0 0 1e-200 0'//slash)
      call check(skipping(counted_coordinates) == 12, 'one of two at 12 steps')
      call check(twin(counted_coordinates) > 12, 'both')
    end if

    if (begin('a pendulum that nothing swings is its spring')) then
      skipping = work(swing//slash//swing_motion//'initial = 0.01 0 0 0 0 0'//slash, &
                      'skips: 2 coordinates at rest')
      twin = work(swing//slash//swing_motion//'initial = 0.01 0 1e-200 0 0 0'//slash)
      call check(skipping(counted_coordinates) == skipping(counted_accelerations), 'z alone')
      call check(twin(counted_coordinates) == 3*twin(counted_accelerations), 'all three')
      twin = work(swing//'m01 = 1e-200'//slash//swing_motion//'initial = 0.01 0 0 0 0 0'//slash)
      call check(twin(counted_coordinates) == 3*twin(counted_accelerations), 'moved by a moment')
    end if
  end subroutine idle_coordinates

  !> Response of the system of a scene, with idle coordinates omitted or included.
  subroutine respond(text, method, keep_idle, counts)
    character(len=*), intent(in) :: text
    integer, intent(in) :: method
    logical, intent(in) :: keep_idle
    integer(i8), allocatable, intent(out) :: counts(:)
    type(scene_type), target :: scene
    type(response_options) :: options
    type(response_plan_type) :: plan
    type(response_type) :: found
    type(status_type) :: status
    integer :: i

    call read_scene('skips.nml', scene, status, text)
    call check_ok(status)
    options%keep_idle = keep_idle
    call reset_counters()
    associate (subject => scene%subject, nu => frequencies(scene))
      call new_response_plan(plan, subject%oscillator(), subject%load, nu, method, options, status)
      call check_ok(status)
      call forced_response(plan, subject%oscillator(), subject%load, nu, found)
    end associate
    call check(.not. any(abs(found%coefficients(:, 2, :)) > 0.0_wp), 'b rests')
    i = findloc(found%orders, 1, 1)
    call check(all(abs(found%coefficients(i, 1, :)) > 1.0e-3_wp), 'a moves')
    counts = [(counted(i), i=1, size(counter_names))]
  end subroutine respond

  subroutine outputs()
    character(len=*), parameter :: spectrum = '&spectrum'//nl
    character(len=*), parameter :: start = swing//slash//swing_motion &
                                           //'initial = 0.01 0 0.1 0 0 0'//nl
    integer(i8), allocatable :: skipping(:), twin(:)

    if (begin('no spectrum wanted, none made')) then
      call compare(work(start//slash, 'skips: Fourier transforms'), &
                   work(start//slash//spectrum//slash), [counted_fourier])
    end if

    if (begin('only what is wanted of coordinates is transformed and written')) then
      skipping = work(start//"coordinates = 'phi'"//slash//spectrum//"coordinates = 'phi'"//slash, &
                      'skips: Fourier transforms of z, psi')
      twin = work(start//slash//spectrum//slash)
      call check(skipping(counted_fourier) == 3 .and. twin(counted_fourier) == 9, 'transforms')
      call check(skipping(counted_columns) == 2 .and. twin(counted_columns) == 6, 'columns')
      skipping = work(mount//load//response//nl//"coordinates = 'phi'"//slash, &
                      'skips: columns of x')
      twin = work(mount//load//response//slash)
      call check(skipping(counted_columns) == 1 .and. twin(counted_columns) == 2, 'of responses')
    end if

    if (begin('no trajectory wanted, none kept')) then
      call compare(work(start//"keep = 'last'"//slash, 'skips: storing states'), &
                   work(start//slash), [counted_states])
      call compare(work(mount//kernel//load//motion//nl//"keep = 'last'"//slash, &
                        'skips: storing states'), &
                   work(mount//kernel//load//motion//slash), [counted_states])
    end if

    if (begin('a step that is given is not sought')) then
      skipping = work(start//slash, 'skips: estimate of the error')
      twin = work(swing//slash//'&transient'//nl//'t_end = 20'//nl//'initial = 0.01 0 0.1 0 0 0' &
                  //slash)
      call check(skipping(counted_runs) == 1 .and. twin(counted_runs) > 1, 'runs')
    end if

    if (begin('corrections are kept when asked for')) then
      skipping = work(mount//load//response//slash, 'skips: history of corrections')
      call check(skipping(counted_corrections) == 0, 'none')
      call corrections(twin)
      call check(twin(counted_corrections) > 0, 'some')
    end if
  end subroutine outputs

  subroutine corrections(counts)
    integer(i8), allocatable, intent(out) :: counts(:)
    type(scene_type), target :: scene
    type(response_options) :: options
    type(response_plan_type) :: plan
    type(response_type) :: found
    type(status_type) :: status
    integer :: i

    call read_scene('skips.nml', scene, status, mount//load//response//slash)
    call check_ok(status)
    options%keep_history = .true.
    associate (subject => scene%subject, nu => frequencies(scene))
      call new_response_plan(plan, subject%oscillator(), subject%load, nu, method_successive, &
                             options, status)
      call check_ok(status)
      call reset_counters()
      call forced_response(plan, subject%oscillator(), subject%load, nu, found)
    end associate
    counts = [(counted(i), i=1, size(counter_names))]
  end subroutine corrections

  subroutine zeros()
    character(len=*), parameter :: spring = pair//'3 -1 -1 8'//slash
    character(len=*), parameter :: cube = '&force'//nl//"on = 'a'"//nl//'powers = 3 0'//nl &
                                          //'coefficient = '

    if (begin('monomials, kernels and loads of nothing cost nothing')) then
      call compare(work(spring//cube//'0'//slash//load//response//slash, &
                        'skips: 1 nonlinear term (coefficient 0)'), &
                   work(spring//cube//'1'//slash//load//response//slash), &
                   [counted_monomials, counted_turns])
      call compare(work(spring//cube//'0'//slash//load//motion//rest//slash, &
                        'skips: 1 nonlinear term (coefficient 0)'), &
                   work(spring//kernel//cube//'1'//slash//load//motion//slash), &
                   [counted_monomials])
      call compare(work(mount//silent_kernel//load//response//slash, &
                        'skips: memory of 1 kernel (factor 0)'), &
                   work(mount//kernel//load//response//slash), [counted_transforms])
      call compare(work(mount//silent_kernel//load//motion//slash, &
                        'skips: memory of 1 kernel (factor 0)'), &
                   work(mount//kernel//load//motion//slash), [counted_memory])
      call compare(work(body//'memory_scale = 0'//slash//kernel//load//response//slash, &
                        'skips: memory of 1 kernel (factor 0)'), &
                   work(mount//kernel//load//response//slash), [counted_transforms])
      call compare(work(linear_mount//'&load'//nl//'amplitude = 0'//slash//response//slash, &
                        'skips: the load'), &
                   work(linear_mount//load//response//slash), [counted_loads, counted_unknowns])
      call compare(work(mount//load//response//slash, 'skips: base motion'), &
                   work(mount//load//'&load'//nl//"kind = 'base'"//nl//'amplitude = 0.01'//slash &
                        //response//slash), [counted_base])
    end if
  end subroutine zeros

end module test_skips
