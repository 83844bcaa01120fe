! Optimize: -O1
!> A motion of a structure in time as one job, like `viscovib_hereditary_job`: modes
!! by exact steps, forces of its elements by collocation (`viscovib_structure_march`).
module viscovib_structure_job
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_base_motion, only: base_motion_type
  use viscovib_hereditary_job, only: hereditary_job, plan_forces, run_with_memory
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_memory_pieces, only: structure_equations
  use viscovib_modal_maps, only: sections_type
  use viscovib_motion_choice, only: hereditary_methods, nodes
  use viscovib_plan_text, only: report_laws, report_table
  use viscovib_status, only: show, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: structure_model
  use viscovib_transient_job, only: trajectory_type
  use viscovib_transient_plan, only: plan_steps
  use viscovib_watch, only: renumbered
  implicit none
  private

  public :: run_structure_job, plan_structure, rate_of_structure, rate_seen

contains

  subroutine run_structure_job(job, model, system, places, trajectory, status)
    type(hereditary_job), intent(in) :: job
    type(structure_model), intent(in) :: model
    !> The condensed model.
    type(structure_type), intent(in), target :: system
    !> Coordinates kept.
    integer, intent(in) :: places(:)
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(structure_equations), target :: equations
    type(hereditary_job) :: own
    real(wp) :: first(size(job%initial))
    integer :: i, n

    equations%system => system%polynomial_type
    call equations%set_past(matmul(job%held, model%directions))
    allocate (equations%load%frequencies(0), equations%load%amplitudes(0, 0))
    allocate (equations%load%breaks(0), equations%load%pieces(0, 4, 0))
    if (model%load%has_table()) then
      equations%load%breaks = model%load%table%breaks
      equations%load%pieces = model%load%table%pieces
      deallocate (equations%load%amplitudes)
      allocate (equations%load%amplitudes(size(model%load%pushes, 2), 0))
    end if
    call set_sections(equations, job, model, system, places)
    associate (frequencies => model%load%orders*job%nu)
      if (model%load%moves_base()) then
        equations%base%direction = model%base_direction(places)
        equations%base%frequencies = frequencies
        equations%base%amplitudes = spread(model%load%base, 1, 1)
      end if
    end associate
    call set_start(equations, job, model, first)
    n = size(places)
    own = job
    own%initial = [(first(2*places(i) - 1:2*places(i)), i=1, n)]
    if (allocated(job%watched)) then
      own%watched = renumbered(job%watched, size(model%base_direction), places)
    end if
    equations%damps_modes = .true.
    call run_with_memory(own, equations%system, equations, rate_seen(equations), &
                         model%load%corners(), trajectory, status)
    trajectory%places = places
  end subroutine run_structure_job

  !> Set the linear subsystem and its loads for the motion in time.
  subroutine set_sections(equations, job, model, system, places)
    type(structure_equations), intent(inout) :: equations
    type(hereditary_job), intent(in) :: job
    type(structure_model), intent(in) :: model
    type(structure_type), intent(in) :: system
    integer, intent(in) :: places(:)
    complex(wp), allocatable :: forces(:, :)
    real(wp), allocatable :: twice(:), inertia(:)
    integer, allocatable :: kept(:)
    integer :: i, m

    associate (sections => equations%sections, rest => model%rest, load => model%load)
      m = size(rest%squares)
      sections%squares = rest%squares
      sections%rates = rest%rates
      sections%seen = system%rest%seen(:m, :)
      sections%pushed = with_columns(system%rest%pushed(:m, :), rest%shapes, load)
      sections%frequencies = load%orders*job%nu
      ! Loads as given, and the inertia of coordinates relative to a moving base.
      allocate (inertia, source=model%inertia())
      allocate (forces, mold=load%force)
      do i = 1, size(load%orders)
        forces(:, i) = load%force_at(i, job%nu) + sections%frequencies(i)**2*load%base(i)*inertia
      end do
      sections%waves = matmul(transpose(rest%shapes), forces)
      sections%inner = matmul(inertia, rest%shapes)
      equations%shown = transpose(rest%shapes(places, :))
      ! One of each pair of conjugate poles, which counts twice.
      kept = pack([(i, i=1, size(rest%poles))], aimag(rest%poles) >= 0.0_wp)
      twice = merge(2.0_wp, 1.0_wp, aimag(rest%poles(kept)) > 0.0_wp)
      associate (others => sections%others, right => rest%right(:, kept))
        others%poles = rest%poles(kept)
        others%left = spread(twice, 2, size(sections%seen, 2))*system%rest%left(kept, :)
        others%right = system%rest%right(kept, :)
        if (load%has_table()) then
          others%right = reshape([others%right, matmul(transpose(right), load%pushes)], &
                                 [size(kept), size(others%right, 2) + size(load%pushes, 2)])
        end if
        others%sine = matmul(transpose(right), real(forces))
        others%cosine = matmul(transpose(right), aimag(forces))
        equations%shown_left = spread(twice, 2, size(places))*transpose(rest%left(places, kept))
      end associate
    end associate
    call set_base(equations%sections, model)
    if (m > 0) return
    ! One mode that does not move.
    associate (sections => equations%sections, q => size(system%rest%seen, 2))
      sections%squares = [0.0_wp]
      sections%rates = [0.0_wp]
      sections%inner = [0.0_wp]
      sections%seen = spread(spread(0.0_wp, 1, q), 1, 1)
      i = q
      if (model%load%has_table()) i = q + size(model%load%pushes, 2)
      sections%pushed = spread(spread(0.0_wp, 1, i), 1, 1)
      sections%waves = spread(spread((0.0_wp, 0.0_wp), 1, size(model%load%orders)), 1, 1)
      equations%shown = spread(spread(0.0_wp, 1, size(places)), 1, 1)
    end associate
  end subroutine set_sections

  !> Pushes of elements on modes, and of the loads in time.
  pure function with_columns(pushed, shapes, load) result(wide)
    real(wp), intent(in) :: pushed(:, :), shapes(:, :)
    type(load_type), intent(in) :: load
    real(wp), allocatable :: wide(:, :)
    integer :: q
    q = size(pushed, 2)
    if (load%has_table()) q = q + size(load%pushes, 2)
    allocate (wide(size(pushed, 1), q))
    wide(:, :size(pushed, 2)) = pushed
    if (load%has_table()) wide(:, size(pushed, 2) + 1:) = matmul(transpose(shapes), load%pushes)
  end function with_columns

  !> Change of the part without real modes due to a jump of the base.
  subroutine set_base(sections, model)
    type(sections_type), intent(inout) :: sections
    type(structure_model), intent(in) :: model
    real(wp) :: nothing(size(model%base_direction))

    nothing = 0.0_wp
    sections%others%by_base = pole_state(model, model%base_direction, nothing)
    sections%others%by_base_rate = pole_state(model, nothing, model%base_direction)
  end subroutine set_base

  !> The start relative to the base, by modes; and in coordinates: massless coordinates are set to
  !! their equilibrium.
  subroutine set_start(equations, job, model, first)
    type(structure_equations), intent(inout) :: equations
    type(hereditary_job), intent(in) :: job
    type(structure_model), intent(in) :: model
    real(wp), intent(out) :: first(:)
    type(base_motion_type) :: base
    complex(wp) :: z(size(model%rest%poles))
    real(wp), allocatable :: q(:), speed(:)
    real(wp), dimension(size(job%initial)/2) :: u, v

    u = job%initial(1::2)
    v = job%initial(2::2)
    base = equations%base
    if (base%moves()) base%direction = model%base_direction
    call base%add_to(0.0_wp, u, v, share=-1.0_wp)
    allocate (q(size(equations%sections%squares)), source=0.0_wp)
    allocate (speed(size(equations%sections%squares)), source=0.0_wp)
    ! Without real modes there is one mode that does not move.
    if (size(model%rest%squares) > 0) then
      call model%rest%in_modes(model%mass, 0.0_wp*u, u, q, z)
      speed = matmul(matmul(model%mass, v), model%rest%shapes)
    end if
    associate (others => pole_state(model, u, v))
      equations%q = [q, real(others)]
      equations%v = [speed, aimag(others)]
    end associate
    first = job%initial
    if (.not. any(model%rest%idle)) return
    call model%rest%place_idle(u)
    call model%rest%place_idle(v)
    call base%add_to(0.0_wp, u, v)
    first(1::2) = merge(u, first(1::2), model%rest%idle)
    first(2::2) = merge(v, first(2::2), model%rest%idle)
  end subroutine set_start

  !> z_l = right_l . ((pole_l M + C) u + M u'); the state is sum_l (left_l, pole_l left_l)
  !! z_l.
  function pole_state(model, u, v) result(z)
    type(structure_model), intent(in) :: model
    real(wp), intent(in) :: u(:), v(:)
    complex(wp) :: z(count(aimag(model%rest%poles) >= 0.0_wp)), all_z(size(model%rest%poles))
    real(wp) :: q(size(model%rest%squares)), damped(size(u))

    z = (0.0_wp, 0.0_wp)
    if (size(z) == 0 .or. .not. (any(abs(u) > 0.0_wp) .or. any(abs(v) > 0.0_wp))) return
    ! Extended precision, so that rounding of a strong damper causes no force on a small motion.
    damped = real(matmul(real(model%all_damping(), real128), real(u, real128)), wp)
    call model%rest%in_modes(model%mass, damped, u, q, all_z)
    all_z = all_z + matmul(matmul(model%mass, v), model%rest%right)
    z = pack(all_z, aimag(model%rest%poles) >= 0.0_wp)
  end function pole_state

  !> The frequency that determines the first steps (rad/s), with all coordinates kept.
  real(wp) function rate_of_structure(model, system, nu) result(fastest)
    type(structure_model), intent(in) :: model
    type(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    type(structure_equations) :: equations
    type(hereditary_job) :: job
    integer :: i
    job%nu = nu
    call set_sections(equations, job, model, system, [(i, i=1, size(model%base_direction))])
    fastest = rate_seen(equations)
  end function rate_of_structure

  !> Modes need no small steps: the first steps depend on the periods of the loads, and on the
  !! frequency at which the observed part of the modes is as stiff as it is heavy.
  real(wp) function rate_seen(equations) result(fastest)
    type(structure_equations), intent(in) :: equations
    real(wp) :: soft, heavy

    soft = 0.0_wp
    heavy = 0.0_wp
    call add(equations%shown, equations%shown_left)
    call add(equations%sections%seen, equations%sections%others%left)
    fastest = maxval([equations%sections%frequencies, 0.0_wp])
    if (soft > 0.0_wp) fastest = max(fastest, sqrt(heavy/soft))

  contains

    subroutine add(seen, left)
      real(wp), intent(in) :: seen(:, :)
      complex(wp), intent(in) :: left(:, :)
      integer :: k, m
      ! Instantaneous variables, the last ones, do not swing.
      m = size(left, 1) - equations%sections%others%n_at_once
      associate (bends => inverse(abs(equations%sections%squares)), &
                 others => inverse(abs(equations%sections%others%poles(:m))**2))
        do k = 1, size(seen, 2)
          soft = max(soft, sum(seen(:, k)**2*bends) + sum(abs(left(:m, k))**2*others))
          heavy = max(heavy, sum(seen(:, k)**2) + sum(abs(left(:m, k))**2))
        end do
      end associate
    end subroutine add

    !> 1/x, or 0.
    elemental real(wp) function inverse(x)
      real(wp), intent(in) :: x
      inverse = 0.0_wp
      if (x > 0.0_wp) inverse = 1.0_wp/x
    end function inverse

  end function rate_seen

  !> Text of the plan: computed and skipped parts, with reasons.
  function plan_structure(job, system, load) result(text)
    type(hereditary_job), intent(in) :: job
    type(structure_type), intent(in) :: system
    !> On the coordinates.
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')

    text = 'computes: motion to t = '//show(job%t_end)//' by ' &
           //trim(hereditary_methods(job%method))//', forces of elements at ' &
           //show(nodes(job%method))//' nodes a step, modes exactly'//nl//plan_steps(job) &
           //plan_forces(job, system%polynomial_type, load)//report_laws(system) &
           //report_table(load)
  end function plan_structure

end module viscovib_structure_job
