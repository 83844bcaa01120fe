!> Tasks about backbones: curves of undamped free vibrations.
module viscovib_backbone_tasks
  use viscovib_backbone, only: follow_backbone
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_branch_tasks, only: given_curve
  use viscovib_curve_branch, only: curve_branch_type, curve_options
  use viscovib_free_family, only: check_begun, follow_family, free_circle, free_family_type, &
    free_options
  use viscovib_free_pendulum, only: begin_free, free_text
  use viscovib_kinds, only: i8, wp
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: fail, status_input_error
  use viscovib_task, only: task_type
  implicit none
  private

  public :: backbone_task

contains

  subroutine backbone_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('oscillator')
      call follow_oscillator(task)
    case ('pendulum')
      call follow_pendulum(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine backbone_task

  !> Backbone of a `mode`, from 0, by the amplitude of coordinate `dof`, from 1 (0: the coordinate
  !! that moves most; `name` is its name). `harmonics`: number of orders, 0: set by the tolerance.
  !! Returns its plan and cosines (m, n_dof, n); no points if no start is found.
  subroutine follow_oscillator(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(backbone_plan_type), target :: plan
    type(curve_branch_type) :: backbone
    type(curve_options) :: options
    integer, allocatable :: orders(:)
    character(len=:), allocatable :: name
    integer :: harmonics, m, n, n_dof

    system => task%system()
    call task%take_text('name', name, '')
    options = given_curve(task)
    harmonics = task%get_integer('harmonics', 0)
    if (task%failed()) return
    call new_backbone_plan(plan, system, task%get_integer('mode'), task%get_integer('dof'), &
                           name, max(harmonics, 1), harmonics == 0, options%tolerance, task%status)
    if (task%failed()) return
    call follow_backbone(plan, options, backbone, orders, task%cancel)
    m = size(orders)
    n = backbone%n_points
    n_dof = system%n_dof()
    associate (found => task%found, folds => backbone%folds)
      call found%put_text('text', plan%text(options%start, options%finish))
      call found%put_integer('ended', int(backbone%outcome, i8))
      call found%put_integers('harmonics', orders, [m])
      call found%put_reals('nu', backbone%x(m*n_dof + 1, :n), [n])
      call found%put_reals('truncation', backbone%truncation(:n), [n])
      call found%put_reals('error', backbone%error(:n), [n])
      call found%put_reals('off', backbone%off(:n), [n])
      call found%put_reals('cosines', backbone%x(:m*n_dof, :n), [m, n_dof, n])
      call found%put_reals('folds', folds%p(:folds%n), [folds%n])
      call found%put_reals('fold_errors', folds%error(:folds%n), [folds%n])
    end associate
  end subroutine follow_oscillator

  !> Free vibrations of the pendulum in a `mode`, from 0, by their amplitude (the cosine of an order
  !! of coordinate `dof`, from 1; 0: the one that moves most) or, `by_energy`, their energy; only
  !! `symmetric` ones, or all. The highest order is `harmonics` times `order`, or, if `chosen`, set
  !! by the tolerance up to `most` times `order`. The curve starts at the linear mode, or, with a
  !! direction `along`, at the cosines `begin` up to order `harmonics` times `order`, the frequency
  !! `begin_nu` and the size `begin_p`.
  subroutine follow_pendulum(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer :: pendulum
    type(pendulum_type), target :: system
    type(free_options) :: options
    type(free_family_type) :: family
    real(wp), pointer, contiguous :: begin(:), along(:)

    pendulum => task%pendulum()
    options%mode = task%get_integer('mode')
    options%chosen = task%get_flag('chosen')
    options%symmetric = task%get_flag('symmetric')
    options%highest = task%get_integer('harmonics')
    options%most = task%get_integer('most')
    options%dof = task%get_integer('dof')
    options%order = task%get_integer('order')
    options%curve = given_curve(task)
    options%stability = task%get_flag('stability')
    if (task%failed()) return
    call begin_free(pendulum, task%get_flag('by_energy'), options, system, task%status)
    if (task%failed()) return
    if (task%has('along')) then
      begin => task%get_reals('begin')
      along => task%get_reals('along')
      call task%check_extents('begin', shape(begin), shape(options%begin))
      call task%check_extents('along', shape(along), [size(begin) + 2])
      if (task%failed()) return
      if (maxval(abs(along(:size(begin))), .not. [options%kept(options%highest*options%order)]) &
          > 1.0e-6_wp*maxval(abs(along(:size(begin))))) then
        call fail(task%status, status_input_error, 'leave', 'leave: the bifurcating motions do ' &
                  //'not have this symmetry: give symmetric=False')
        return
      end if
      call follow_family(family, system, options, begin, task%status, task%cancel, &
                         task%get_real('begin_nu'), task%get_real('begin_p'), along)
    else
      call follow_family(family, system, options, options%begin, task%status, task%cancel)
    end if
    if (.not. task%failed()) call check_begun(family, options%curve, task%status)
    if (task%failed()) return
    call put_family(task, family)
    call lock_texts()
    call task%found%put_text('text', free_text(options))
    call unlock_texts()
  end subroutine follow_pendulum

  !> Cosines are for all orders, (m, 3, n); `multipliers` (6, n) in descending order, NaN if
  !! unknown, and the number outside of the unit circle, -1: unknown.
  subroutine put_family(task, family)
    type(task_type), intent(inout) :: task
    type(free_family_type), intent(in) :: family
    integer :: i, m, n, n_points

    n = size(family%parameter)
    m = size(family%x, 1)
    n_points = size(family%branch_p)
    associate (found => task%found)
      call found%put_integer('ended', int(family%outcome, i8))
      call found%put_integer('highest', int(family%highest, i8))
      call found%put_reals('nu', family%nu, [n])
      call found%put_reals('energy', family%energy, [n])
      call found%put_reals('truncation', family%truncation, [n])
      call found%put_reals('error', family%error, [n])
      call found%put_reals('off', family%off, [n])
      call found%put_reals('cosines', family%x, [m/3, 3, n])
      if (allocated(family%multipliers)) then
        call found%put_complexes('multipliers', family%multipliers, shape(family%multipliers))
        call found%put_integers('growing', [(count_larger(family%multipliers(:, i), free_circle), &
                                             i=1, size(family%multipliers, 2))], &
                                [size(family%multipliers, 2)])
      end if
      call found%put_reals('folds', family%folds, shape(family%folds))
      call found%put_reals('fold_errors', family%fold_errors, shape(family%fold_errors))
      call found%put_reals('branch_p', family%branch_p, [n_points])
      call found%put_reals('branch_nu', family%branch_nu, [n_points])
      call found%put_reals('branch_cosines', family%branch_x, [m/3, 3, n_points])
      call found%put_reals('across', family%across, [m + 2, n_points])
      call found%put_integers('branch_before', family%branch_before, [n_points])
    end associate
  end subroutine put_family

end module viscovib_backbone_tasks
