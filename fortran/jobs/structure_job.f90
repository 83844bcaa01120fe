!> A motion of a structure in time as one job, as `viscovib_hereditary_job` has it of others: modes
!! exactly from step to step, forces of its elements collocated (`viscovib_structure_march`).
module viscovib_structure_job
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_base_motion, only: base_motion_type
  use viscovib_constants, only: pi
  use viscovib_hereditary_job, only: hereditary_job, hereditary_methods, hereditary_runs, &
    make_hereditary, nodes, per_period, plan_forces, reach
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_march, only: march_type
  use viscovib_modal_maps, only: sections_type
  use viscovib_plan_text, only: tell_laws
  use viscovib_status, only: show, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_march, only: new_structure_march, structure_march_type
  use viscovib_structure_model, only: structure_model
  use viscovib_trajectory, only: shaken
  use viscovib_transient_job, only: trajectory_type
  use viscovib_transient_plan, only: plan_steps
  use viscovib_watch, only: renumbered
  implicit none
  private

  public :: run_structure_job, plan_structure, rate_of_structure

  !> Runs whose state are the modes.
  type, extends(hereditary_runs) :: structure_runs
    type(sections_type) :: sections
    !> Coordinates kept by modes, shape (n_modes, n_kept), and by what has no real modes.
    real(wp), allocatable :: shown(:, :)
    complex(wp), allocatable :: shown_left(:, :)
    !> Deflections held for all t < 0; start relative to the base by modes, then real and imaginary
    !! parts of what has no real ones.
    real(wp), allocatable :: held(:), q(:), v(:)
  contains
    procedure :: start
    procedure :: shake
  end type structure_runs

contains

  subroutine run_structure_job(job, model, system, places, trajectory, status)
    type(hereditary_job), intent(in) :: job
    type(structure_model), intent(in) :: model
    !> What the model was condensed to.
    type(structure_type), intent(in), target :: system
    !> Coordinates kept.
    integer, intent(in) :: places(:)
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(structure_runs) :: maker
    type(hereditary_job) :: own
    real(wp) :: first(size(job%initial))
    integer :: i, n

    maker%system => system%polynomial_type
    maker%held = matmul(job%held, model%directions)
    allocate (maker%load%frequencies(0), maker%load%amplitudes(0, 0))
    allocate (maker%load%breaks(0), maker%load%pieces(0, 4, 0))
    call set_sections(maker, job, model, system, places)
    associate (frequencies => model%load%orders*job%nu)
      if (model%load%moves_base()) then
        maker%base%direction = model%base_direction(places)
        maker%base%frequencies = frequencies
        maker%base%amplitudes = spread(model%load%base, 1, 1)
      end if
    end associate
    call set_start(maker, job, model, first)
    n = size(places)
    maker%first = [(first(2*places(i) - 1:2*places(i)), i=1, n)]
    own = job
    if (allocated(job%watched)) then
      own%watched = renumbered(job%watched, size(model%base_direction), places)
    end if
    call make_hereditary(maker, own, first_steps(maker, job), trajectory, status)
    trajectory%places = places
  end subroutine run_structure_job

  !> The rest and its loads, as the motion in time takes them.
  subroutine set_sections(maker, job, model, system, places)
    type(structure_runs), intent(inout) :: maker
    type(hereditary_job), intent(in) :: job
    type(structure_model), intent(in) :: model
    type(structure_type), intent(in) :: system
    integer, intent(in) :: places(:)
    complex(wp), allocatable :: forces(:, :)
    real(wp), allocatable :: twice(:), inertia(:)
    integer, allocatable :: kept(:)
    integer :: i, m

    associate (sections => maker%sections, rest => model%rest, load => model%load)
      m = size(rest%squares)
      sections%squares = rest%squares
      sections%rates = rest%rates
      sections%seen = system%rest%seen(:m, :)
      sections%pushed = system%rest%pushed(:m, :)
      sections%frequencies = load%orders*job%nu
      ! Loads as they are, and the inertia of what is relative to a base that moves.
      inertia = inertia_of(model)
      forces = load%force
      do i = 1, size(load%orders)
        forces(:, i) = forces(:, i) + sections%frequencies(i)**2*load%base(i)*inertia
      end do
      sections%waves = matmul(transpose(rest%shapes), forces)
      sections%inner = matmul(inertia, rest%shapes)
      maker%shown = transpose(rest%shapes(places, :))
      ! Of conjugate poles one, which counts twice.
      kept = pack([(i, i=1, size(rest%poles))], aimag(rest%poles) >= 0.0_wp)
      twice = merge(2.0_wp, 1.0_wp, aimag(rest%poles(kept)) > 0.0_wp)
      associate (others => sections%others, right => rest%right(:, kept))
        others%poles = rest%poles(kept)
        others%left = spread(twice, 2, size(sections%seen, 2))*system%rest%left(kept, :)
        others%right = system%rest%right(kept, :)
        others%sine = matmul(transpose(right), real(forces))
        others%cosine = matmul(transpose(right), aimag(forces))
        maker%shown_left = spread(twice, 2, size(places))*transpose(rest%left(places, kept))
      end associate
    end associate
    call set_base(maker%sections, model)
    if (m > 0) return
    ! One mode that does not move.
    associate (sections => maker%sections, q => size(system%rest%seen, 2))
      sections%squares = [0.0_wp]
      sections%rates = [0.0_wp]
      sections%inner = [0.0_wp]
      sections%seen = spread(spread(0.0_wp, 1, q), 1, 1)
      sections%pushed = sections%seen
      sections%waves = spread(spread((0.0_wp, 0.0_wp), 1, size(model%load%orders)), 1, 1)
      maker%shown = spread(spread(0.0_wp, 1, size(places)), 1, 1)
    end associate
  end subroutine set_sections

  !> What a jump of the base does to what has no real modes.
  subroutine set_base(sections, model)
    type(sections_type), intent(inout) :: sections
    type(structure_model), intent(in) :: model
    real(wp) :: nothing(size(model%base_direction))

    nothing = 0.0_wp
    sections%others%by_base = pole_state(model, model%base_direction, nothing)
    sections%others%by_base_rate = pole_state(model, nothing, model%base_direction)
  end subroutine set_base

  !> The start relative to the base, by modes; and as it is: what has no mass is where the others
  !! put it.
  subroutine set_start(maker, job, model, first)
    type(structure_runs), intent(inout) :: maker
    type(hereditary_job), intent(in) :: job
    type(structure_model), intent(in) :: model
    real(wp), intent(out) :: first(:)
    type(base_motion_type) :: base
    complex(wp) :: z(size(model%rest%poles))
    real(wp), allocatable :: q(:), speed(:)
    real(wp), dimension(size(job%initial)/2) :: u, v

    u = job%initial(1::2)
    v = job%initial(2::2)
    base = maker%base
    if (base%moves()) base%direction = model%base_direction
    call base%add_to(0.0_wp, u, v, share=-1.0_wp)
    allocate (q(size(maker%sections%squares)), speed(size(maker%sections%squares)), source=0.0_wp)
    ! Without real modes there is one that does not move.
    if (size(model%rest%squares) > 0) then
      call model%rest%in_modes(model%mass, 0.0_wp*u, u, q, z)
      speed = matmul(matmul(model%mass, v), model%rest%shapes)
    end if
    associate (others => pole_state(model, u, v))
      maker%q = [q, real(others)]
      maker%v = [speed, aimag(others)]
    end associate
    first = job%initial
    if (.not. any(model%rest%idle)) return
    call model%rest%place_idle(u)
    call model%rest%place_idle(v)
    call base%add_to(0.0_wp, u, v)
    first(1::2) = merge(u, first(1::2), model%rest%idle)
    first(2::2) = merge(v, first(2::2), model%rest%idle)
  end subroutine set_start

  !> z_l = right_l . ((pole_l M + C) u + M u'), of which the state is sum_l (left_l, pole_l left_l)
  !! z_l.
  function pole_state(model, u, v) result(z)
    type(structure_model), intent(in) :: model
    real(wp), intent(in) :: u(:), v(:)
    complex(wp) :: z(count(aimag(model%rest%poles) >= 0.0_wp)), all_z(size(model%rest%poles))
    real(wp) :: q(size(model%rest%squares)), damped(size(u))

    z = (0.0_wp, 0.0_wp)
    if (size(z) == 0 .or. .not. (any(abs(u) > 0.0_wp) .or. any(abs(v) > 0.0_wp))) return
    ! What hardly moves a strong damper is not resisted by its rounding.
    damped = real(matmul(real(model%all_damping(), real128), real(u, real128)), wp)
    call model%rest%in_modes(model%mass, damped, u, q, all_z)
    all_z = all_z + matmul(matmul(model%mass, v), model%rest%right)
    z = pack(all_z, aimag(model%rest%poles) >= 0.0_wp)
  end function pole_state

  !> M b, of a base that moves the coordinates by b.
  function inertia_of(model) result(inertia)
    type(structure_model), intent(in) :: model
    real(wp) :: inertia(size(model%base_direction))
    inertia = 0.0_wp
    if (any(abs(model%base_direction) > 0.0_wp)) then
      inertia = matmul(model%mass, model%base_direction)
    end if
  end function inertia_of

  !> The frequency that tells first steps (rad/s), with all coordinates kept.
  real(wp) function rate_of_structure(model, system, nu) result(fastest)
    type(structure_model), intent(in) :: model
    type(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    type(structure_runs) :: maker
    type(hereditary_job) :: job
    integer :: i
    job%nu = nu
    call set_sections(maker, job, model, system, [(i, i=1, size(model%base_direction))])
    fastest = rate_seen(maker)
  end function rate_of_structure

  !> Steps to begin with.
  real(wp) function first_steps(maker, job) result(n)
    type(structure_runs), intent(in) :: maker
    type(hereditary_job), intent(in) :: job
    n = max(4.0_wp, job%t_end*rate_seen(maker)*per_period(job%method)/(2.0_wp*pi))
  end function first_steps

  !> Modes need no steps: so many a period of the loads, and of the frequency at which what is seen
  !! of the modes is as stiff as it is heavy.
  real(wp) function rate_seen(maker) result(fastest)
    type(structure_runs), intent(in) :: maker
    real(wp) :: soft, heavy

    soft = 0.0_wp
    heavy = 0.0_wp
    call add(maker%shown, maker%shown_left)
    call add(maker%sections%seen, maker%sections%others%left)
    fastest = maxval([maker%sections%frequencies, 0.0_wp])
    if (soft > 0.0_wp) fastest = max(fastest, sqrt(heavy/soft))

  contains

    subroutine add(seen, left)
      real(wp), intent(in) :: seen(:, :)
      complex(wp), intent(in) :: left(:, :)
      real(wp) :: bends(size(seen, 1)), others(size(left, 1))
      integer :: k

      bends = abs(maker%sections%squares)
      bends = merge(1.0_wp, 0.0_wp, bends > 0.0_wp)/merge(bends, 1.0_wp, bends > 0.0_wp)
      others = 1.0_wp/abs(maker%sections%others%poles)**2
      do k = 1, size(seen, 2)
        soft = max(soft, sum(seen(:, k)**2*bends) + sum(abs(left(:, k))**2*others))
        heavy = max(heavy, sum(seen(:, k)**2) + sum(abs(left(:, k))**2))
      end do
    end subroutine add

  end function rate_seen

  subroutine start(self, job, base, past, h, solved, run, reason, shortest)
    class(structure_runs), intent(in) :: self
    type(hereditary_job), intent(in) :: job
    type(base_motion_type), intent(inout) :: base
    integer, intent(in) :: past
    real(wp), intent(in) :: h, solved
    class(march_type), allocatable, intent(out) :: run
    integer, intent(out) :: reason
    real(wp), intent(in), optional :: shortest
    type(structure_march_type), allocatable :: own

    allocate (own)
    associate (not_needed => base)
      call new_structure_march(own, self%system, self%sections, self%shown, self%shown_left, &
                               self%load, nodes(job%method), past, self%held, self%q, self%v, h, &
                               reach*job%t_end, solved, reason, shortest=shortest)
    end associate
    call move_alloc(own, run)
  end subroutine start

  !> Forces of loads and elements have other values, by 1 + 2 s.
  subroutine shake(self, sign)
    class(structure_runs), intent(inout) :: self
    integer, intent(in) :: sign
    real(wp), parameter :: pushed = 1.0_wp + 2.0_wp*shaken
    real(wp) :: begun
    begun = 1.0_wp + sign*shaken
    self%first = begun*self%first
    self%q = begun*self%q
    self%v = begun*self%v
    associate (sections => self%sections)
      sections%pushed = pushed*sections%pushed
      sections%waves = pushed*sections%waves
      sections%others%right = pushed*sections%others%right
      sections%others%sine = pushed*sections%others%sine
      sections%others%cosine = pushed*sections%others%cosine
    end associate
  end subroutine shake

  !> What will be computed and what is skipped, with the reasons.
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
           //plan_forces(job, system%polynomial_type, load)//tell_laws(system)
  end function plan_structure

end module viscovib_structure_job
